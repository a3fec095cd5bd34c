"""Navigate: drive to where the next skill can begin, facing what it acts on.

M3 has 20 discrete actions, one of them "stop"; ours are continuous speeds. Our robot has a map, which M3's has not: a
point of the planned path is observed, and the robot stops where the map says that it has arrived.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar

import numpy as np

from perdure.errors import PerdureError
from perdure.home.sim.arrays import BoolArray, FloatArray
from perdure.home.sim.occupancy import Geodesic
from perdure.home.sim.pieces import Apartment
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.sensors import SCAN_RANGE, PrivilegedState, SkillGoal, wrap
from perdure.home.sim.simulator import NAVIGATION_SPEED
from perdure.home.skills import skill as obs
from perdure.home.skills.registry import get_skill
from perdure.home.skills.skill import Recipe, Skill, SkillProgress
from perdure.home.skills.starts import Aim, Start, region, stand_anywhere
from perdure.home.tasks.episodes import Episode
from perdure.home.tasks.planning import make_plan

NEAR = 0.1
FACING = 0.25
"""Largest path length to the region in [m] and heading error in [rad] on arrival (M3)."""
COUNTED = 0.05
"""Path lengths up to this count as 0 in the reward, in [m] (M3)."""
DISTANCE_REWARD = 1.0
FAR = 5.0
"""Clip of the path length in [m]."""
STUCK_STEPS = 90
STUCK_WAY = 0.2
STUCK_TURN = 1.0
"""A robot that has moved less than this, in [m] and in [rad], for so many control steps is stuck (our choice). How fast
it moves does not matter: one that cannot get nearer may rock to and fro for ever."""


def _path(state: PrivilegedState, _: SkillProgress) -> list[FloatArray]:
    aim = state.in_base(state.aim)
    ahead = state.in_base(state.waypoint)
    far = np.sqrt(aim[:, 0] ** 2 + aim[:, 1] ** 2)
    safe = np.maximum(far, 1e-9)
    return [
        *(aim[:, 0], aim[:, 1], far, aim[:, 0] / safe, aim[:, 1] / safe),
        *obs.HOLDING.read(state, _),
        *(ahead[:, 0], ahead[:, 1], np.minimum(state.way, FAR)),
    ]


PATH = obs.ObservationBlock(
    (
        *obs.vector("aim_in_base", "position of the aim (the object, goal or handle to face) in the base frame", "xy"),
        obs.Element("aim_distance", "horizontal distance of the aim", "m", 0.0),
        obs.Element("aim_cos", "cosine of the turn that would face the aim", "1", -1.0, 1.0),
        obs.Element("aim_sin", "sine of that turn", "1", -1.0, 1.0),
        *obs.HOLDING.elements,
        *obs.vector("waypoint", "point of the planned path 0.5 m ahead, base frame", "xy"),
        obs.Element("way", "length of the planned path, clipped at 5 m", "m", 0.0, FAR),
    ),
    _path,
)


@dataclass(frozen=True)
class Navigate(Skill):
    """M3's reward and success condition."""

    name = "navigate"
    step_limit = 500
    observation = (obs.PROPRIOCEPTION, PATH, obs.SCAN)
    rewards: ClassVar = {
        "way": f"{DISTANCE_REWARD:g} per meter nearer to the region of the next skill but the last {COUNTED:g} m"
    }
    success_text = (
        f"the robot has stopped at most {NEAR:g} m of path from the region and turned at most {FACING:g} rad from the "
        "aim; it stops by itself when its map says that it has arrived"
    )
    failures: ClassVar = {"stopped elsewhere": "the robot stopped outside the region or did not face the aim"}
    recipe = Recipe(1_500_000)
    active_columns = (ROBOT.action.forward, ROBOT.action.turn)
    base_speed = NAVIGATION_SPEED
    scan_reach = SCAN_RANGE

    def reward_terms(
        self, before: PrivilegedState, after: PrivilegedState, was: SkillProgress, now: SkillProgress
    ) -> Mapping[str, FloatArray]:
        """See `Skill.reward_terms`."""
        return {"way": DISTANCE_REWARD * (counted_way(before) - counted_way(after))}

    def success(self, state: PrivilegedState, progress: SkillProgress) -> BoolArray:
        """See `success_text`."""
        return state.stopped & _arrived(state)

    def failure_conditions(self, state: PrivilegedState, progress: SkillProgress) -> Mapping[str, BoolArray]:
        """See `failures`; a robot that slid on after it stopped has failed, too."""
        return {"stopped elsewhere": state.stopped & ~_arrived(state)}

    def stop(self, state: PrivilegedState, progress: SkillProgress) -> BoolArray:
        """Stop wherever the robot has stopped, or is stuck (our choice)."""
        return np.asarray(state.stopped | (progress.lasting >= STUCK_STEPS))

    def remember(self, progress: SkillProgress, state: PrivilegedState) -> SkillProgress:
        """See `Skill.remember`; `lasting` counts the steps since the robot was last away from where it is."""
        moved = state.base - progress.anchor
        near = np.hypot(moved[:, 0], moved[:, 1]) < STUCK_WAY
        stays = near & (np.abs(wrap(moved[:, 2])) < STUCK_TURN)
        lasting = np.where(stays, progress.lasting + 1, 0)
        anchor = np.where(stays[:, None], progress.anchor, state.base)
        return super().remember(replace(progress, lasting=lasting, anchor=anchor), state)

    def mask(self, actions: FloatArray, state: PrivilegedState) -> FloatArray:
        """Keep arm and gripper still, and stop on arrival if the action's stop column is 0."""
        masked = actions.copy()
        masked[:, ROBOT.action.arm] = 0.0
        masked[:, ROBOT.action.grip] = 0.0
        stop = actions[:, ROBOT.action.stop]
        masked[:, ROBOT.action.stop] = np.where((stop == 0.0) & _arrived(state), 1.0, stop)
        return masked

    def skill_goal(
        self, episode: Episode, target: int, opened: Mapping[str, float], toward: str | None = None
    ) -> SkillGoal:
        """Return the goal of the next skill, with the path to its region. PerdureError when there is no next skill."""
        following = self._following(toward)
        space, cells = region(episode.apartment(), opened, following.aim(episode, target, opened))
        goal = following.skill_goal(episode, target, opened)
        return replace(goal, route=space.distances(cells), front=(0.0, 0.0))

    def draw_start(self, episode: Episode, target: int, rng: np.random.Generator) -> Start:
        """Draw a start anywhere, before one of the plan's navigations to this target, in the room as it is at first.

        The object is in the hand if it is placed next (M3, `nav_v1*`).
        """
        steps = [each for each in make_plan(episode.home_task) if (each.skill, each.target) == (self.name, target)]
        following = self._following(steps[int(rng.integers(len(steps)))].toward)
        opened = dict(episode.opened)
        base = stand_anywhere(episode.apartment(), opened, rng)
        start = following.make_start(episode, target, opened, base, rng)
        route = _route(episode.apartment(), tuple(sorted(opened.items())), following.aim(episode, target, opened))
        return replace(start, skill_goal=replace(start.skill_goal, route=route, front=(0.0, 0.0)))

    def _following(self, toward: str | None) -> Skill:
        if toward is None or toward == self.name:
            raise PerdureError("a navigate step needs toward: the name of the next skill, which decides where to go")
        return get_skill(toward)


def counted_way(state: PrivilegedState) -> FloatArray:
    """Return the length of the path to the region in [m], 0 up to `COUNTED`. Shape (n,)."""
    return np.where(state.way <= COUNTED, 0.0, state.way)


def _arrived(state: PrivilegedState) -> BoolArray:
    return np.asarray((state.way <= NEAR) & (np.abs(state.facing_error) <= FACING))


@lru_cache(maxsize=1024)
def _route(apartment: Apartment, opened: tuple[tuple[str, float], ...], aim: Aim) -> Geodesic:
    """Return the path lengths to where the next skill may begin; at most 0.3 MB each."""
    space, cells = region(apartment, dict(opened), aim)
    return space.distances(cells)
