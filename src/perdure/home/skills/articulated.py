"""What the four skills share that open or close a drawer or the fridge: hold the handle, move it, let go, retract."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from perdure.home.sim.world import PrivilegedState
from perdure.home.sim.world.state import norm
from perdure.home.skills.observation import (
    CLOSENESS,
    PROPRIOCEPTION,
    closeness,
    facing,
    point,
    point_elements,
    proprioception,
)
from perdure.home.skills.skill import Element, Progress, Skill, first_of, invalid_grasp, rest_distance

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

DISTANCE_REWARD, JOINT_REWARD = 2.0, 2.0
GRASP_REWARD, RELEASE_REWARD = 1.0, 1.0
RETRACTED = 0.15
"""How near the gripper point must be to rest in [m] (M3: looser than after pick and place)."""


_FACE = tuple(Element(f"face_{a}", f"which way the handle's face visuals, base axes {a}", "1", -1.0, 1.0) for a in "xy")


@dataclass(frozen=True)
class Articulated(Skill):
    """A skill that brings a drawer or door to a wanted position by its handle.

    Reward (M3): 2 per meter nearer to the handle until it is held, +1 for the first right grasp, 2 per meter or radian
    nearer to the wanted position while it is held, +1 for letting go there, then 2 per meter nearer to rest.
    """

    slack = 0.0
    failures: ClassVar[tuple[str, ...]] = (
        "none",
        "wrong grasp",
        "let go early",
        "left the goal",
        "invalid grasp",
        "excess force",
    )
    wanted: ClassVar[float]
    """Wanted joint position in [m] or [rad]."""
    knows_front: ClassVar[bool] = False
    """Whether it is told which way the handle's face visuals."""

    @property
    def elements(self) -> tuple[Element, ...]:
        """See `Skill.elements`."""
        return (
            *PROPRIOCEPTION,
            *CLOSENESS,
            *point_elements("handle", "the handle"),
            Element("to_wanted", "wanted minus joint position", "m or rad"),
            Element("joint_speed", "speed of the drawer or door", "m/s or rad/s"),
            Element("holding", "1 when the handle is held", "1", 0.0, 1.0),
            *(_FACE if self.knows_front else ()),
        )

    def observe(self, state: PrivilegedState, progress: Progress) -> FloatArray:
        """See `Skill.observe`."""
        columns = [
            *proprioception(state),
            closeness(state),
            *point(state, state.handle),
            (self.wanted - state.link_position)[:, None],
            state.link_velocity[:, None],
            holds_handle(state).astype(np.float64)[:, None],
        ]
        if self.knows_front:
            columns.append(facing(state, self.front(state)))
        return np.concatenate(columns, axis=1)

    def front(self, state: PrivilegedState) -> FloatArray:
        """Which way the handle's face visuals, in the room. Shape (n, 3)."""
        return state.front

    def there(self, position: FloatArray) -> BoolArray:
        """Whether the drawer or door is where it should be. Shape (n,)."""
        raise NotImplementedError

    def terms(
        self, before: PrivilegedState, after: PrivilegedState, was: Progress, now: Progress
    ) -> Mapping[str, FloatArray]:
        """See `Skill.terms`."""
        approach = norm(before.handle - before.gripper) - norm(after.handle - after.gripper)
        moved = np.abs(self.wanted - before.link_position) - np.abs(self.wanted - after.link_position)
        retract = rest_distance(before) - rest_distance(after)
        let_go = now.released & ~was.released & self.there(after.link_position)
        return {
            "approach": DISTANCE_REWARD * np.where(~now.grasped, approach, 0.0),
            "grasp": np.where(now.grasped & ~was.grasped, GRASP_REWARD, 0.0),
            "move": JOINT_REWARD * np.where(holds_handle(after), moved, 0.0),
            "release": np.where(let_go, RELEASE_REWARD, 0.0),
            "retract": DISTANCE_REWARD * np.where(was.released, retract, 0.0),
        }

    def success(self, state: PrivilegedState, progress: Progress) -> BoolArray:
        """It is where it should be, the hand is empty and within 0.15 m of rest."""
        retracted = rest_distance(state) <= RETRACTED
        done: BoolArray = self.there(state.link_position) & state.empty_hand & retracted
        return done

    def failure(self, state: PrivilegedState, progress: Progress) -> IntArray:
        """See `Skill.failure`."""
        there = self.there(state.link_position)
        return first_of(
            ~state.empty_hand & ~holds_handle(state),
            progress.released & ~progress.reached,
            progress.released & progress.reached & ~there,
            invalid_grasp(state),
            progress.force_sum > self.force_limit,
        )

    def stop(self, state: PrivilegedState, progress: Progress) -> BoolArray:
        """The hand is empty and back near rest after it was more than 0.3 m away; M3 does not look at the joint."""
        done: BoolArray = state.empty_hand & (rest_distance(state) <= RETRACTED) & progress.away
        return done

    def _remember(self, progress: Progress, state: PrivilegedState) -> Progress:
        progress = super()._remember(progress, state)
        holds = holds_handle(state)
        grasped = progress.grasped | holds
        return replace(
            progress,
            grasped=grasped,
            released=progress.released | (grasped & ~holds),
            reached=progress.reached | self.there(state.link_position),
        )


def holds_handle(state: PrivilegedState) -> BoolArray:
    """Whether the skill_goal's handle is held. Shape (n,)."""
    holds: BoolArray = (state.link >= 0) & (state.held_link == state.link)
    return holds
