"""A start state of a skill, and how a lane is brought to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from perdure.home.benchmark.episodes import Episode
from perdure.home.errors import HomeError
from perdure.home.sim.apartments import Pose
from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.objects import Placement
from perdure.home.sim.world import Scene, Simulator, SkillGoal, VectorSimulator

TRIES = 1000
"""Largest number of draws for one start state; published episodes need a few dozen at most."""
TOUCH = 0.001
"""Largest penetration depth of the robot, or of what it holds, at the start in [m] (OURS)."""


@dataclass(frozen=True, eq=False)
class Start:
    """The state in which a skill begins. Objects are numbered as in a scene that has the skill's target only."""

    base: Pose
    arm: FloatArray
    """Joint angles. Shape (7,)."""
    skill_goal: SkillGoal
    opened: Mapping[str, float] = field(default_factory=dict)
    """Positions of drawers and doors that differ from the episode's, by link name."""
    held: int = -1
    """Number of the held object, -1 for none."""
    moved: Mapping[int, Placement] = field(default_factory=dict)
    """Placements of objects that have moved since the episode's start, by number."""


Draw = Callable[[Episode, int, np.random.Generator], Start]
"""Draws a start state for (episode, target), without a check for contacts."""


def begin(
    world: VectorSimulator, lane: int, scene: Scene, draw: Draw, episode: Episode, target: int, rng: np.random.Generator
) -> Start:
    """Bring a lane to a start state without contacts, drawn with `draw` until there is one.

    The scene is the episode's with `SceneOptions(targets=(target,))`. HomeError if all of 1000 draws have contacts.
    """
    for _ in range(TRIES):
        start = draw(episode, target, rng)
        put(world, lane, scene, start)
        if touching(world.simulator(lane)) <= TOUCH:
            return start
    raise HomeError(f"{episode.name}: the robot touches something in all of {TRIES} start states drawn for {target=}")


def put(world: VectorSimulator, lane: int, scene: Scene, start: Start) -> None:
    """Bring a lane to a start state."""
    world.reset(lane, scene, start.base, start.arm, start.opened, start.held, start.skill_goal, start.moved)


def touching(lane: Simulator) -> float:
    """Return the penetration depth of the robot, or of what it holds, in [m], 0 without contact."""
    contact, scene = lane.data.contact, lane.scene
    geoms, distance = contact.geom, contact.dist
    if not len(distance):
        return 0.0
    ours = scene.robot_geoms[geoms]
    if lane.held >= 0:
        ours |= np.isin(geoms, scene.object_geoms[lane.held])
    between = ours[:, 0] != ours[:, 1]
    return float(max(0.0, -distance[between].min())) if between.any() else 0.0
