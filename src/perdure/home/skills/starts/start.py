"""What a start of a skill is, and how a lane is brought to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from perdure.home.benchmark.episodes import Episode
from perdure.home.errors import HomeError
from perdure.home.sim.apartments import Pose
from perdure.home.sim.objects import Placement
from perdure.home.sim.world import Lane, Scene, SkillGoal, World

FloatArray = NDArray[np.float64]

TRIES = 1000
"""Draws for one start; in every published episode one of the first few dozen is free."""
TOUCH = 0.001
"""Depth in [m] up to which the robot, or what it holds, may be inside something at the start (OURS)."""


@dataclass(frozen=True, eq=False)
class Start:
    """Where a skill begins. Objects are numbered as in a scene whose only target is the skill's own."""

    base: Pose
    arm: FloatArray
    """Joint angles. Shape (7,)."""
    skill_goal: SkillGoal
    opened: Mapping[str, float] = field(default_factory=dict)
    """Positions of drawers and doors by link name where they differ from the episode's."""
    held: int = -1
    """Number of the object in the gripper, -1 for none."""
    moved: Mapping[int, Placement] = field(default_factory=dict)
    """Objects that are elsewhere than at the episode's start, by number."""


Draw = Callable[[Episode, int, np.random.Generator], Start]
"""Draws a start for (episode, target); whether the robot has room there is not looked at."""


def begin(
    world: World, lane: int, scene: Scene, draw: Draw, episode: Episode, target: int, rng: np.random.Generator
) -> Start:
    """Draws until the robot is free of contacts, and leaves the lane there.

    Args:
        world: The world.
        lane: Which of its lanes.
        scene: The episode's scene with `SceneOptions(targets=(target,))`.
        draw: The skill's own start distribution.
        episode: The episode.
        target: Number of the target in the episode.
        rng: What to draw from.

    Raises:
        HomeError: When none of 1000 draws is free.
    """
    for _ in range(TRIES):
        start = draw(episode, target, rng)
        put(world, lane, scene, start)
        if touching(world.lane(lane)) <= TOUCH:
            return start
    raise HomeError(f"{episode.name}: nowhere can the robot begin with target {target}; {TRIES} draws collide")


def put(world: World, lane: int, scene: Scene, start: Start) -> None:
    """Brings a lane to a start."""
    world.reset(lane, scene, start.base, start.arm, start.opened, start.held, start.skill_goal)
    one = world.lane(lane)
    for number, placement in start.moved.items():
        address = scene.object_qpos[number]
        one.qpos[address : address + 7] = *placement.position, *placement.quaternion
    if start.moved:
        import mujoco

        mujoco.mj_forward(one.model, one.data)


def touching(lane: Lane) -> float:
    """How deep the robot, or what it holds, is inside something else in [m], 0 for free."""
    contact, scene = lane.data.contact, lane.scene
    geoms, distance = contact.geom, contact.dist
    if not len(distance):
        return 0.0
    ours = scene.robot_geoms[geoms]
    if lane.held >= 0:
        ours |= np.isin(geoms, scene.object_geoms[lane.held])
    between = ours[:, 0] != ours[:, 1]
    return float(max(0.0, -distance[between].min())) if between.any() else 0.0
