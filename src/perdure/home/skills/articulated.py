"""The skills that open or close a drawer or the fridge by its handle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from perdure.home.sim.arrays import BoolArray, FloatArray
from perdure.home.sim.pieces import CONTAINERS, Apartment
from perdure.home.sim.sensors import PrivilegedState, norm, turn
from perdure.home.skills import skill as obs
from perdure.home.skills.skill import Recipe, Skill, SkillProgress
from perdure.home.skills.starts import (
    Aim,
    Rectangle,
    Start,
    front_frame,
    handle,
    needed_container,
    stand_in,
)
from perdure.home.tasks.episodes import Episode

DISTANCE_REWARD = 2.0
JOINT_REWARD = 2.0
GRASP_REWARD = 1.0
RELEASE_REWARD = 1.0
RETRACTED = 0.15
"""Largest distance of a retracted gripper point from rest in [m] (M3: larger than after pick and place)."""
HANDLE = obs.point("handle", "the handle", lambda state: state.handle)
JOINT = (
    obs.Element("to_wanted", "wanted minus actual joint position", "m or rad"),
    obs.Element("joint_speed", "speed of the drawer or door", "m/s or rad/s"),
    obs.flag("holding", "the handle is held"),
)
ARTICULATED: dict[str, type[Articulated]] = {}
"""The skills of this kind by name. A subclass that has a name is one as soon as it is defined."""
FACE = obs.vector("face", "direction in which the handle faces", "xy", "1", 1.0)


@dataclass(frozen=True)
class Articulated(Skill):
    """A skill that brings a drawer or door to a wanted position by its handle.

    Reward and failures follow M3, with the differences that docs/home/differences.md lists.
    """

    rewards: ClassVar = {
        "approach": f"{DISTANCE_REWARD:g} per meter nearer to the handle, until it is held for the first time",
        "grasp": f"+{GRASP_REWARD:g} when the handle is held for the first time",
        "move": f"{JOINT_REWARD:g} per meter or radian nearer to the wanted position while the handle is held",
        "release": f"+{RELEASE_REWARD:g} for letting go at the wanted position",
        "retract": f"{DISTANCE_REWARD:g} per meter nearer to rest after that",
    }
    failures: ClassVar = {
        "wrong grasp": "the hand holds something other than the handle",
        "let go early": "the handle was let go before the drawer or door had reached its wanted position",
        "left the goal": "the drawer or door left its wanted position after the handle was let go",
        **Skill.failures,
    }
    slack = 0.0
    moves_link = True
    ends_with_empty_hand = True
    wanted: ClassVar[float]
    """Wanted joint position in [m] or [rad]."""
    accepted: ClassVar[tuple[float, float]]
    """Range of accepted joint positions, both ends included (M3)."""
    knows_front: ClassVar[bool] = True
    """Whether the direction in which the handle faces is observed."""
    start_range: ClassVar[tuple[float, float] | None] = None
    """Uniform range of the joint position at the start; closed when None (M3)."""
    start_rectangles: ClassVar[tuple[Rectangle, ...]]
    """Where the robot begins, in the frame of `front_frame`; the second where the first one has no free cell (M3)."""
    navigation_region: ClassVar[Rectangle]
    """Where navigation to the skill ends, in the same frame (M3)."""
    scripted_goal: ClassVar[float]
    """Joint position to which the oracle brings it, in [m] or [rad] (our choice)."""
    scripted_tolerance: ClassVar[float]
    """Distance from it at which the oracle lets go, in [m] or [rad] (our choice)."""
    scripted_distance: ClassVar[float]
    """Best distance of the oracle from the handle, along the floor in [m] (our choice)."""

    def __init_subclass__(cls) -> None:
        """Add a subclass that has a name to `ARTICULATED`."""
        super().__init_subclass__()
        if "name" in vars(cls):
            ARTICULATED[cls.name] = cls

    def is_accepted(self, position: FloatArray) -> BoolArray:
        """Return whether joint positions are accepted. Shape (n,)."""
        return np.asarray((position >= self.accepted[0]) & (position <= self.accepted[1]))

    def draw_opened(self, apartment: Apartment, link: str, rng: np.random.Generator) -> dict[str, float]:
        """Draw the positions of drawers and doors that are open at the start, by link name."""
        return {link: float(rng.uniform(*self.start_range))} if self.start_range else {}

    def front(self, state: PrivilegedState) -> FloatArray:
        """Return the direction in which the handle faces, in the room. Shape (n, 3)."""
        return state.front

    def way_to_handle(self, state: PrivilegedState) -> FloatArray:
        """Return the length of the gripper point's way to the handle in [m]. Shape (n,)."""
        return norm(state.handle - state.gripper)

    def observation_blocks(self) -> tuple[obs.ObservationBlock, ...]:
        """See `Skill.observation_blocks`."""
        joint = obs.ObservationBlock(
            JOINT,
            lambda state, _: [
                self.wanted - state.link_position,
                state.link_velocity,
                holds_handle(state).astype(float),
            ],
        )
        face = obs.ObservationBlock(FACE, lambda state, _: [obs.facing(state, self.front(state))])
        return (obs.PROPRIOCEPTION, obs.CLOSENESS, HANDLE, joint, *((face,) if self.knows_front else ()))

    def reward_terms(
        self, before: PrivilegedState, after: PrivilegedState, was: SkillProgress, now: SkillProgress
    ) -> Mapping[str, FloatArray]:
        """See `Skill.reward_terms`."""
        approach = self.way_to_handle(before) - self.way_to_handle(after)
        moved = np.abs(self.wanted - before.link_position) - np.abs(self.wanted - after.link_position)
        retract = obs.rest_distance(before) - obs.rest_distance(after)
        let_go = now.released & ~was.released & self.is_accepted(after.link_position)
        return {
            "approach": DISTANCE_REWARD * np.where(~now.grasped, approach, 0.0),
            "grasp": np.where(now.grasped & ~was.grasped, GRASP_REWARD, 0.0),
            "move": JOINT_REWARD * np.where(holds_handle(after), moved, 0.0),
            "release": np.where(let_go, RELEASE_REWARD, 0.0),
            "retract": DISTANCE_REWARD * np.where(was.released, retract, 0.0),
        }

    def success(self, state: PrivilegedState, progress: SkillProgress) -> BoolArray:
        """Succeed at the wanted position with an empty hand within 0.15 m of rest."""
        retracted = obs.rest_distance(state) <= RETRACTED
        return np.asarray(self.is_accepted(state.link_position) & state.empty_hand & retracted)

    def failure_conditions(self, state: PrivilegedState, progress: SkillProgress) -> Mapping[str, BoolArray]:
        """See `failures`."""
        return {
            "wrong grasp": ~state.empty_hand & ~holds_handle(state),
            "let go early": progress.released & ~progress.reached,
            "left the goal": progress.released & progress.reached & ~self.is_accepted(state.link_position),
            **super().failure_conditions(state, progress),
        }

    def stop(self, state: PrivilegedState, progress: SkillProgress) -> BoolArray:
        """Stop with an empty hand near rest after it was more than 0.3 m away, at any joint position (M3)."""
        return np.asarray(state.empty_hand & (obs.rest_distance(state) <= RETRACTED) & progress.away)

    def remember(self, progress: SkillProgress, state: PrivilegedState) -> SkillProgress:
        """See `Skill.remember`."""
        holds = holds_handle(state)
        grasped = progress.grasped | holds
        own = replace(
            progress,
            grasped=grasped,
            released=progress.released | (grasped & ~holds),
            reached=progress.reached | self.is_accepted(state.link_position),
        )
        return super().remember(own, state)

    def aim(self, episode: Episode, target: int, opened: Mapping[str, float]) -> Aim:
        """Return the handle of the target's container; the target itself when it has none."""
        link = episode.container(target)
        if link is None:
            return Aim(episode.objects[target].position)
        return Aim(handle(episode.apartment(), link, opened.get(link, 0.0)), link, self.navigation_region)

    def draw_start(self, episode: Episode, target: int, rng: np.random.Generator) -> Start:
        """Draw a start state in front of the handle, facing it."""
        apartment = episode.apartment()
        link = needed_container(episode, target)
        opened = self.draw_opened(apartment, link, rng)
        frame = front_frame(apartment, link, opened.get(link, 0.0))
        base = stand_in(apartment, frame, self.start_rectangles, self.aim(episode, target, opened).point, rng)
        return self.make_start(episode, target, opened, base, rng)


def holds_handle(state: PrivilegedState) -> BoolArray:
    """Return whether the goal's handle is held. Shape (n,)."""
    return np.asarray((state.link >= 0) & (state.held_link == state.link))


def success_text(position: str) -> str:
    """Return `Skill.success_text` from the condition on the joint position."""
    return f"{position}, the hand is empty and the gripper is within {RETRACTED:g} m of rest"


PAST_EDGE = 0.1
"""From a door's handle past its free edge in [m]."""
STOP_YIELD = 0.005
"""Yield of the simulated stop to a pulling hand in [m]; a drawer at its stop is open (our choice)."""
OTHERS_OPEN = 0.1
"""Largest initial opening of the other drawers, drawn uniformly, in [m] (our choice; in M3 they are closed here, and a
random subset of them is open by up to this in `close_drawer`)."""


@dataclass(frozen=True)
class OpenDrawer(Articulated):
    """M3's success condition and start states (`open_drawer_v0A`), except for the other drawers, see `OTHERS_OPEN`."""

    name = "open_drawer"
    wanted = 0.45
    accepted = (0.45 - 0.05, 0.45 + 0.05 + STOP_YIELD)
    success_text = success_text("the drawer is within 0.05 m of 0.45 m (at its stop it may be 5 mm beyond)")
    start_rectangles = (Rectangle((0.3, 1.5), 0.6),)
    navigation_region = Rectangle((0.80, 0.95), 0.35)
    recipe = Recipe(2_000_000, {"log_std_end": -2.0, "log_std_fall": (0.5, 0.9)})
    scripted_goal = 0.45
    scripted_tolerance = 0.02
    scripted_distance = 0.85

    def draw_opened(self, apartment: Apartment, link: str, rng: np.random.Generator) -> dict[str, float]:
        """Draw the positions of the other drawers, which are not quite closed."""
        drawers = [each.link for each in apartment.articulations if each.kind == "slide" and each.link != link]
        return {each: float(rng.uniform(0.0, OTHERS_OPEN)) for each in drawers}


@dataclass(frozen=True)
class CloseDrawer(Articulated):
    """M3's success condition and start states (`close_drawer_v0A`), except that the other drawers are closed."""

    name = "close_drawer"
    knows_front = False
    wanted = 0.0
    accepted = (-0.05, 0.05)
    success_text = success_text("the drawer is within 0.05 m of 0")
    object_at_start = "goal"
    start_range = CONTAINERS["drawer"].start_range
    start_rectangles = (Rectangle((0.3, 1.0), 0.6),)
    navigation_region = Rectangle((0.30, 0.45), 0.35)
    recipe = Recipe(1_000_000)
    scripted_goal = 0.0
    scripted_tolerance = 0.02
    scripted_distance = 0.5


class Fridge(Articulated):
    """M3's start states. An open door hides its handle from a robot in front of it, so its direction is observed."""

    start_rectangles = (Rectangle((0.933, 1.833), 0.6), Rectangle((0.8, 2.0), 1.0))
    navigation_region = Rectangle((0.9, 1.8), 0.5)
    recipe = Recipe(2_000_000, {"log_std_init": -0.5, "log_std_end": -2.0, "log_std_fall": (0.4, 0.9)})
    scripted_tolerance = 0.05

    def front(self, state: PrivilegedState) -> FloatArray:
        """Return the direction in which the door faces; its hinge turns to the right as it opens."""
        return turn(super().front(state), -state.link_position)


@dataclass(frozen=True)
class OpenFridge(Fridge):
    """M3's `open_fridge_v0A`, but wider open (our choice): a robot that passes a door at M3's pi/2 - 0.15 closes it."""

    name = "open_fridge"
    wanted = np.pi / 2.0 + 0.3
    accepted = (np.pi / 2.0 + 0.1, np.inf)
    success_text = success_text("the door is at pi/2 + 0.1 rad or beyond")
    scripted_goal = 1.8
    scripted_distance = 0.95


@dataclass(frozen=True)
class CloseFridge(Fridge):
    """M3's success condition (`close_fridge_v0A`)."""

    name = "close_fridge"
    wanted = 0.0
    accepted = (-0.15, 0.15)
    success_text = success_text("the door is within 0.15 rad of 0")
    object_at_start = "goal"
    scripted_goal = 0.0
    scripted_distance = 0.9
    start_range = (np.pi / 2.0 - 0.15, 2.356)
    rewards: ClassVar = {
        **Articulated.rewards,
        "approach": f"{Articulated.rewards['approach']}; behind the open door the way leads around its edge",
    }

    def way_to_handle(self, state: PrivilegedState) -> FloatArray:
        """See `Articulated.way_to_handle`: a straight one through the door would end behind it, out of reach."""
        away = state.gripper - state.handle
        front = self.front(state)
        edge = PAST_EDGE * np.stack([-front[:, 1], front[:, 0], np.zeros(len(state))], axis=1)
        return np.where((away * front).sum(axis=1) < 0.0, norm(away - edge) + PAST_EDGE, norm(away))
