"""A lane with visual geometry, for pictures only.

Visual geometry in the simulated scene would change the last bits of the physics, and with them the trajectory. So
episodes run without it, and a second lane is set to the same positions before each picture.
"""

from __future__ import annotations

from perdure.home.benchmark.episodes import Episode, episode_scene, start_pose
from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.world import SceneOptions, Simulator


def render_scene(episode: Episode, eval_seed: int) -> Simulator:
    """Return a lane with visual geometry at the start of an episode."""
    scene = episode_scene(episode, SceneOptions(visuals=True))
    simulator = Simulator(scene)
    simulator.reset(start_pose(scene.apartment, episode, eval_seed))
    return simulator


def put(simulator: Simulator, qpos: FloatArray) -> None:
    """Set all positions of a lane to those of another one of the same episode. Shape (nq,)."""
    simulator.qpos[:] = qpos
    simulator.forward()
