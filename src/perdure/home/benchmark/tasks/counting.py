"""Two ways of counting what was reached, side by side.

*Latched*, as the benchmark counts: a stage is reached at the first step at which its conditions hold, if all earlier
stages are reached by then, and stays reached whatever happens later. A can that is inside its goal region while it
falls has been placed.

*Goal-stabilizing*, as the thesis counts: a placement counts if, once the plan has handled the object for the last time,
the object is in its goal region and out of the hand at every step, to the end of the episode and for a settling time
after it. So it counts at the end only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from perdure.home.benchmark.tasks.facts import WorldFacts
from perdure.home.benchmark.tasks.predicates import at
from perdure.home.benchmark.tasks.task import HomeTask
from perdure.home.errors import HomeError
from perdure.home.sim.arrays import BoolArray, IntArray

SETTLE_STEPS = 150
"""Control steps the world goes on after an episode: 5 s, the time the benchmark's generator gives objects to settle."""


def latch(task: HomeTask, reached: BoolArray, facts: WorldFacts) -> BoolArray:
    """Return which stages are reached after one more step, in latched counting. Shape (*, stages).

    `reached` are those before this step, shape (*, stages); `facts` have leading axes *. Stages are looked at in order;
    the first one that is neither reached nor met ends the look, so one step may reach several stages but never leave
    one out.
    """
    met = np.stack([stage.met(facts) for stage in task.stages], axis=-1)
    return np.logical_and.accumulate(reached | met, axis=-1)


def latched_stages(task: HomeTask, facts: WorldFacts) -> BoolArray:
    """Return which stages are reached after each step of an episode, in latched counting. Shape (steps, *, stages).

    The facts have leading axes (steps, *).
    """
    history = np.empty((*np.shape(facts.held), len(task.stages)), dtype=bool)
    earlier: BoolArray = np.ones(np.shape(facts.held), dtype=bool)
    for k, stage in enumerate(task.stages):
        earlier = np.logical_or.accumulate(earlier & stage.met(facts), axis=0)
        history[..., k] = earlier
    return history


@dataclass(frozen=True)
class Stabilizing:
    """Goal-stabilizing counting while it goes on; `start` makes the first one, `after` the next."""

    handled: BoolArray
    """Whether the plan has handled the object so far. Shape (*, targets)."""
    released: BoolArray
    """Whether a step has passed since it did. Shape (*, targets)."""
    stayed: BoolArray
    """Whether the object was in its goal and out of the hand at every step since. Shape (*, targets)."""

    @staticmethod
    def start(shape: Sequence[int]) -> Stabilizing:
        """Return the state before the first step. `shape` is (*, targets)."""
        return Stabilizing(np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool), np.ones(shape, dtype=bool))

    def after(self, facts: WorldFacts, handling: BoolArray) -> Stabilizing:
        """Return the counting after one more step with these facts.

        `handling`: which objects the plan handles at this step, shape (*, targets).
        """
        handled = self.handled | handling
        later = handled & ~handling
        held = np.asarray(facts.held)[..., None] == np.arange(facts.targets)
        return Stabilizing(handled, later, (handling | self.stayed) & (~later | (at(facts) & ~held)))

    @property
    def counts(self) -> BoolArray:
        """Which placements are goal-stabilizing if nothing more happens. Shape (*, targets)."""
        return self.released & self.stayed


def goal_stabilizing(facts: WorldFacts, handling: BoolArray, settle_steps: int = SETTLE_STEPS) -> BoolArray:
    """Goal-stabilizing counting over a whole episode and the settling time after it.

    Args:
        facts: The facts of all steps, steps first: leading axes (steps, *).
        handling: Which objects the plan handles at each step, nothing in the settling time: from the start of the
            object's pick to the end of its place, see `handling_of`. Shape (steps, *, targets).
        settle_steps: How many steps at the end must be free of handling.

    Returns:
        Which placements are goal-stabilizing. Shape (*, targets).
    """
    if len(handling) != len(facts):
        raise HomeError(f"handling has {len(handling)} steps, the facts have {len(facts)}")
    if len(facts) < settle_steps or handling[len(facts) - settle_steps :].any():
        raise HomeError(f"the last {settle_steps} steps must be a settling time in which the plan handles nothing")
    state = Stabilizing.start(handling.shape[1:])
    for step in range(len(facts)):
        state = state.after(facts[step], handling[step])
    return state.counts


def handling_of(task: HomeTask, active: IntArray) -> BoolArray:
    """Return which objects a plan handles: their pick has begun and their place has not ended. Shape (*, targets).

    `active` is the number of the active skill in the task's sequence; its length or more in the settling time. Shape
    (*).
    """
    number = {(step.skill, step.target): k for k, step in enumerate(task.skills)}
    first, last = (np.array([number[skill, i] for i in range(len(task.targets))]) for skill in ("pick", "place"))
    return (active[..., None] >= first) & (active[..., None] <= last)


def stabilizing_stages(task: HomeTask, reached: BoolArray, stabilizing: BoolArray) -> BoolArray:
    """Return the stages of an episode by goal-stabilizing counting.

    Args:
        task: The task.
        reached: Stages by latched counting at the end. Shape (*, stages).
        stabilizing: Which placements are goal-stabilizing. Shape (*, targets).

    Returns:
        A stage counts when it was reached and every placement up to it is goal-stabilizing. Shape (*, stages).
    """
    kept = np.ones_like(reached)
    for k, stage in enumerate(task.stages):
        if stage.placed is not None:
            kept[..., k:] &= stabilizing[..., stage.placed, None]
    return reached & kept
