"""Place begins within 2 m of the goal with the object in the gripper, the goal's container open (M3, `place_v1`).

In training half the robots may face any way (`draw_any_heading`, OURS): they see more of what is beside their goal.
"""

from __future__ import annotations

import numpy as np

from perdure.home.benchmark.episodes import Episode
from perdure.home.sim.apartments import Pose
from perdure.home.sim.world import SkillGoal
from perdure.home.skills.skill_goals import front
from perdure.home.skills.starts.arm import draw_arm
from perdure.home.skills.starts.containers import draw_open, goal_container
from perdure.home.skills.starts.stand import stand_near
from perdure.home.skills.starts.start import Start


def draw(episode: Episode, target: int, rng: np.random.Generator) -> Start:
    """See `Draw`."""
    return _start(episode, target, rng)


def draw_any_heading(episode: Episode, target: int, rng: np.random.Generator) -> Start:
    """See `Draw`: the same places, but half the robots face any way."""
    return _start(episode, target, rng, any_heading=True)


def _start(episode: Episode, target: int, rng: np.random.Generator, any_heading: bool = False) -> Start:
    apartment, goal = episode.apartment(), episode.goals[target].position
    container, facing = goal_container(episode, target), front(episode, target, "place")
    opened = draw_open(apartment, container, rng)
    base = stand_near(apartment, goal, rng, None if container is None else facing)
    if any_heading and rng.random() < 0.5:
        base = Pose(base.x, base.y, 2.0 * np.pi * float(rng.random()))
    return Start(
        base=base,
        arm=draw_arm(rng),
        skill_goal=SkillGoal(0, goal, toward="place", aim=goal, front=facing),
        opened=opened,
        held=0,
    )
