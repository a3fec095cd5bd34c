"""Carrying lanes through a long evaluation and writing down what becomes of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perdure.envs import World, make_world
from perdure.extrapolate.checkpoints import checkpoint_steps
from perdure.extrapolate.divergence import DivergenceWatch
from perdure.extrapolate.lanes import FIRST_EVAL_SEED, LaneSpec
from perdure.extrapolate.stuck import StuckWatch
from perdure.policy import ClosedLoop, Pilot, Policy
from perdure.policy.one_thread import one_thread

END_REASONS = ("survived", "terminated", "truncated", "diverged")
SURVIVED, TERMINATED, TRUNCATED, DIVERGED = range(4)

Watcher = Callable[[int, int], None]
"""Called now and then with (steps made by every living lane, living lanes)."""


@dataclass(frozen=True, eq=False)
class LaneRecords:
    """What became of n lanes at m checkpoints. Memory does not depend on the number of steps."""

    steps: NDArray[np.int64]
    """Checkpoints, shape (m,)."""
    returns: NDArray[np.float64]
    """Cumulative return at each checkpoint, shape (n, m); an ended lane keeps its last value."""
    stuck_steps: NDArray[np.int64]
    """Steps in stuck phases up to each checkpoint, shape (n, m)."""
    end_step: NDArray[np.int64]
    """Steps the lane completed, the one it ended with included, shape (n,)."""
    end_reason: NDArray[np.int64]
    """Index into END_REASONS, shape (n,)."""
    first_tenth: NDArray[np.float64]
    """Mean reward per step in the first tenth of the test horizon, shape (n,)."""
    last_tenth: NDArray[np.float64]
    """The same for the last tenth; 0 for a lane that had ended before it, shape (n,)."""
    last_observation: NDArray[np.float64]
    """Where each lane ended: its last finite observation, shape (n, d)."""


def evaluate_lanes(
    policies: Sequence[Policy],
    lanes: Sequence[LaneSpec],
    steps: int,
    watch: Watcher = lambda step, living: None,
    world: World | None = None,
) -> LaneRecords:
    """Runs lanes for at most ``steps`` steps each, in this process, on one core.

    Args:
        policies: What the lanes' numbers refer to, all for one task.
        lanes: One or more.
        steps: The test horizon.
        watch: Told about progress.
        world: Where to run; by default the policies' own task, one lane for each evaluation seed.
    """
    pilots = [Pilot(policies[lane.policy], lane.clock) for lane in lanes]
    world = world or make_world(pilots[0].policy.task.name, [FIRST_EVAL_SEED + lane.eval_seed for lane in lanes])
    try:
        loop = ClosedLoop(world, pilots)
        recorder = _Recorder(loop, pilots, steps)
        with one_thread():
            for step in range(1, steps + 1):
                recorder.take(step)
                if step % 500 == 0:
                    watch(step, len(loop.living))
                if not len(loop.living):
                    break
    finally:
        world.close()
    return recorder.records()


class _Recorder:
    """Accumulates what LaneRecords keeps, while the loop runs."""

    def __init__(self, loop: ClosedLoop, pilots: Sequence[Pilot], steps: int) -> None:
        n = len(pilots)
        self._loop = loop
        self._steps = checkpoint_steps(steps)
        self._next = 0
        self._returns, self._stuck = np.zeros((n, len(self._steps))), np.zeros((n, len(self._steps)), np.int64)
        self._total = np.zeros(n)
        self._tenth = max(1, steps // 10)
        self._first_tenth, self._before_last = np.zeros(n), np.zeros(n)
        self._last_start = steps - self._tenth
        self._end_step, self._reason = np.full(n, steps), np.full(n, SURVIVED)
        self._observation = loop.observations.copy()
        self._divergence = DivergenceWatch(self._observation, np.stack([_scale(pilot.policy) for pilot in pilots]))
        self._stuck_watch = StuckWatch(n)

    def take(self, step: int) -> None:
        """Advances the loop by its step number ``step`` and notes what happened."""
        moment = self._loop.advance()
        lanes, result = moment.lanes, moment.step
        rewards = result.rewards
        diverged = self._divergence.diverged(moment)
        if diverged.any():
            # What a world pays for being put back to its start is not a reward.
            rewards = np.where(diverged, 0.0, rewards)
            self._loop.drop(lanes[diverged])
        self._total[lanes] += rewards
        self._stuck_watch.add(lanes, rewards, step)
        ended = result.ended | diverged
        if ended.any():
            self._end(lanes[ended], step, moment.before[ended], result.terminated[ended], diverged[ended])
        if step == self._tenth:
            self._first_tenth = self._total.copy()
        if step == self._last_start:
            self._before_last = self._total.copy()
        if step == self._steps[self._next]:
            self._returns[:, self._next], self._stuck[:, self._next] = self._total, self._stuck_watch.stuck_steps
            self._next += 1
            living = self._loop.living
            self._observation[living] = self._loop.observations

    def _end(
        self,
        lanes: NDArray[np.int64],
        step: int,
        observations: NDArray[np.float64],
        terminated: NDArray[np.bool_],
        diverged: NDArray[np.bool_],
    ) -> None:
        self._end_step[lanes] = step
        self._reason[lanes] = np.where(diverged, DIVERGED, np.where(terminated, TERMINATED, TRUNCATED))
        self._observation[lanes] = observations

    def records(self) -> LaneRecords:
        """Everything noted; lanes that all ended early keep their values at the checkpoints not reached."""
        if self._next < len(self._steps):
            self._returns[:, self._next :] = self._total[:, None]
            self._stuck[:, self._next :] = self._stuck_watch.stuck_steps[:, None]
        ended = self._end_step
        first = np.where(ended < self._tenth, self._total, self._first_tenth)
        last = np.where(ended <= self._last_start, 0.0, self._total - self._before_last)
        return LaneRecords(
            steps=self._steps,
            returns=self._returns,
            stuck_steps=self._stuck,
            end_step=ended,
            end_reason=self._reason,
            first_tenth=first / self._tenth,
            last_tenth=last / self._tenth,
            last_observation=self._observation,
        )


def _scale(policy: Policy) -> NDArray[np.float64]:
    std: NDArray[np.float64] = np.sqrt(policy.normalizer.var[: policy.task.observation_size])
    return std
