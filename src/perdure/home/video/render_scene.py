"""A lane with visual geometry, for pictures only.

Visual geometry in the simulated scene would change the last bits of the physics, and with them the trajectory. So
episodes run without it, and a second lane is set to the same positions before each picture.
"""

from __future__ import annotations

from perdure.home.benchmark.episodes import Episode, episode_scene, start_pose
from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.world import Lane, SceneOptions


def render_scene(episode: Episode, eval_seed: int) -> Lane:
    """Return a lane with visual geometry at the start of an episode."""
    scene = episode_scene(episode, SceneOptions(visuals=True))
    lane = Lane(scene)
    lane.reset(start_pose(scene.apartment, episode, eval_seed))
    return lane


def put(lane: Lane, qpos: FloatArray) -> None:
    """Set all positions of a lane to those of another one of the same episode. Shape (nq,)."""
    lane.qpos[:] = qpos
    lane.forward()
