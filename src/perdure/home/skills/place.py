"""Place: let go of the target within its goal region, so that it stays, and bring the gripper back to rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from perdure.home.benchmark.tasks import LIMITS
from perdure.home.errors import HomeError
from perdure.home.sim.world import GRIP, PrivilegedState
from perdure.home.sim.world.state import norm
from perdure.home.skills.observation import (
    CLOSENESS,
    PROPRIOCEPTION,
    closeness,
    point,
    point_elements,
    proprioception,
    unit,
)
from perdure.home.skills.skill import RETRACTED, Element, Progress, Skill, first_of, invalid_grasp, rest_distance

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

GOAL_RADIUS = 0.15
"""eps_g: how near the object's middle must be to its goal in [m] (M3, habitat-lab)."""
DISTANCE_REWARD = 4.0
RELEASE_REWARD = 1.0


@dataclass(frozen=True)
class Place(Skill):
    """Success over Delta steps (thesis, section 2.1.2).

    At time t: for each of the last Delta steps, t included, the object is within eps_g = 0.15 m of its goal and not
    held, and at t the gripper point is within eps_r = 0.05 m of its rest position. Delta = 1 is the benchmark's rule.

    Reward (M3): while it is held 4 per meter nearer to the goal (OURS: up counts apart, see `left_to_carry`); at the
    first release +1 inside the goal region, else -1 and the end; after it 4 per meter nearer to rest.
    """

    name = "place"
    failures: ClassVar[tuple[str, ...]] = ("none", "wrong drop", "invalid grasp", "excess force")
    force_limit = 7500.0
    delta: int = 1
    """Delta: for how many steps the object must have stayed."""
    limited_to: int | None = None
    """Control steps the skill may last; 200 + Delta (200 for Delta = 1) when None."""

    def __post_init__(self) -> None:
        """Delta below 1 or a limit too short for it raise HomeError."""
        if self.delta < 1:
            raise HomeError(f"delta must be at least 1 step, not {self.delta}")
        if self.limit < self.delta:
            raise HomeError(f"a skill of {self.limit} steps cannot last delta = {self.delta} steps")

    @property
    def limit(self) -> int:
        """See `Skill.limit`."""
        if self.limited_to is not None:
            return self.limited_to
        return LIMITS["place"] + (self.delta if self.delta > 1 else 0)

    @property
    def elements(self) -> tuple[Element, ...]:
        """See `Skill.elements`."""
        lasting = Element("lasting", "share of the delta steps that the object has stayed", "1", 0.0, 1.0)
        return (
            *PROPRIOCEPTION,
            *CLOSENESS,
            *point_elements("goal", "the goal"),
            *(Element(f"object_from_goal_{a}", f"from the goal to the object, base axes {a}", "m") for a in "xyz"),
            Element("goal_distance", "d_o^g: length of that", "m", 0.0),
            *(Element(f"object_up_{a}", f"object's z axis, base axes {a}", "1", -1.0, 1.0) for a in "xyz"),
            Element("holding", "1 when the object is held", "1", 0.0, 1.0),
            *((lasting,) if self.delta > 1 else ()),
        )

    def observe(self, state: PrivilegedState, progress: Progress) -> FloatArray:
        """See `Skill.observe`."""
        columns = [
            *proprioception(state),
            closeness(state),
            *point(state, state.goal),
            state.turned_to_base(state.object - state.goal),
            state.object_to_goal[:, None],
            unit(state.turned_to_base(state.object_up)),
            state.holds_target.astype(np.float64)[:, None],
        ]
        if self.delta > 1:
            columns.append(np.minimum(progress.lasting / self.delta, 1.0)[:, None])
        return np.concatenate(columns, axis=1)

    def terms(
        self, before: PrivilegedState, after: PrivilegedState, was: Progress, now: Progress
    ) -> Mapping[str, FloatArray]:
        """See `Skill.terms`."""
        nearer = left_to_carry(before) - left_to_carry(after)
        retract = rest_distance(before) - rest_distance(after)
        first = now.released & ~was.released
        inside = after.object_to_goal <= GOAL_RADIUS
        return {
            "carry": DISTANCE_REWARD * np.where(after.holds_target, nearer, 0.0),
            "release": np.where(first & inside, RELEASE_REWARD, 0.0),
            "retract": DISTANCE_REWARD * np.where(was.released, retract, 0.0),
        }

    def success(self, state: PrivilegedState, progress: Progress) -> BoolArray:
        """See the class."""
        reached: BoolArray = (progress.lasting >= self.delta) & (rest_distance(state) <= RETRACTED)
        return reached

    def lacks(self, state: PrivilegedState, progress: Progress) -> Mapping[str, BoolArray]:
        """See `Skill.lacks`."""
        return {
            "not let go": ~progress.released,
            "object not in its goal": progress.lasting < 1,
            "object not long enough in its goal": progress.lasting < self.delta,
            "gripper not at rest": rest_distance(state) > RETRACTED,
        }

    def failure(self, state: PrivilegedState, progress: Progress) -> IntArray:
        """A wrong drop is a first release outside the goal region."""
        just = progress.released & (progress.lasting == 0) & ~progress.reached
        return first_of(just, invalid_grasp(state), progress.force_sum > self.force_limit)

    def stop(self, state: PrivilegedState, progress: Progress) -> BoolArray:
        """The hand is empty and back at rest, whatever the object does (M3); with Delta > 1 the count must run out."""
        done = state.empty_hand & (rest_distance(state) < RETRACTED)
        if self.delta > 1:
            done &= progress.lasting >= self.delta
        return np.asarray(done)

    def mask(self, actions: FloatArray, state: PrivilegedState) -> FloatArray:
        """Place never grasps."""
        masked = actions.copy()
        masked[:, GRIP] = np.minimum(masked[:, GRIP], 0.0)
        return masked

    def _remember(self, progress: Progress, state: PrivilegedState) -> Progress:
        progress = super()._remember(progress, state)
        there = (state.object_to_goal <= GOAL_RADIUS) & (state.held != state.target)
        grasped = progress.grasped | state.holds_target
        return replace(
            progress,
            grasped=grasped,
            released=progress.released | (grasped & ~state.holds_target),
            lasting=np.where(there, progress.lasting + 1, 0),
            reached=progress.reached | there,
        )


def left_to_carry(state: PrivilegedState) -> FloatArray:
    """What the object still has to be carried in [m], shape (n,).

    The straight way to a goal below it; what a goal is above it counts apart, so that the object is lifted at once and
    not led against the edge of a shelf. With d = goal - object: |(d_x, d_y, min(d_z, 0))| + max(d_z, 0). OURS, M3 has
    |d|.
    """
    to_goal = state.goal - state.object
    ahead = to_goal.copy()
    ahead[:, 2] = np.minimum(ahead[:, 2], 0.0)
    return np.asarray(norm(ahead) + np.maximum(to_goal[:, 2], 0.0))
