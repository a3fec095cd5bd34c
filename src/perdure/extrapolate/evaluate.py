"""Run lanes for a long evaluation and record their returns and ends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perdure.envs import World, make_world
from perdure.extrapolate.errors import ExtrapolationError
from perdure.extrapolate.lanes import FIRST_EVAL_SEED, LaneSpec, whole
from perdure.extrapolate.movement import MovementRecorder
from perdure.extrapolate.recorded_steps import recorded_steps
from perdure.policy import ClosedLoop, LanePolicy, PolicyLike
from perdure.policy.divergence import DivergenceDetector
from perdure.policy.one_thread import one_thread

END_REASONS = ("survived", "terminated", "truncated", "diverged")
SURVIVED, TERMINATED, TRUNCATED, DIVERGED = range(4)

ProgressCallback = Callable[[int, int], None]
"""Called every 500 steps with (step, running lanes)."""


@dataclass(frozen=True, eq=False)
class LaneRecords:
    """Results of n lanes at m recorded steps. Memory hardly depends on the number of steps."""

    steps: NDArray[np.int64]
    """Recorded steps, shape (m,)."""
    returns: NDArray[np.float64]
    """Cumulative return at each recorded step, shape (n, m); an ended lane keeps its last value."""
    end_step: NDArray[np.int64]
    """Steps the lane made, its last one included, shape (n,)."""
    end_reason: NDArray[np.int64]
    """Index into END_REASONS, shape (n,)."""
    end_detail: list[str]
    """Cause of the end, in words; "" if unknown. Length n."""
    movement: NDArray[np.float64]
    """Movement per step in the first and last tenth of the test horizon, see `MovementRecorder`; shape (2, n)."""


def evaluate_lanes(
    policies: Sequence[PolicyLike],
    lanes: Sequence[LaneSpec],
    steps: int,
    progress: ProgressCallback = lambda step, running: None,
    world: World | None = None,
) -> LaneRecords:
    """Run lanes for at most ``steps`` steps each, in this process, on one core.

    Args:
        policies: All for one task; `LaneSpec.policy` is an index into them.
        lanes: One or more.
        steps: The test horizon.
        progress: Called every 500 steps with (step, running lanes).
        world: The world to run in, one lane for each of ``lanes``; it stays open. By default the policies' own task.

    Raises:
        ExtrapolationError: If there is no lane or no step, or a lane names a policy that there is not.
        PolicyError: If a policy does not fit its clock or the world, or the world has another number of lanes.
        WorldError: If the task's world cannot be built.
    """
    steps = whole("steps", steps, 1)
    if not lanes:
        raise ExtrapolationError("there is no lane to evaluate: give at least one LaneSpec")
    for lane in lanes:
        if not 0 <= lane.policy < len(policies):
            raise ExtrapolationError(
                f"LaneSpec.policy must be an index into {len(policies)} policies, from 0, got {lane.policy}"
            )
    lane_policies = [LanePolicy(policies[lane.policy], lane.clock) for lane in lanes]
    if world is not None:
        return _run(world, lane_policies, steps, progress)
    world = make_world(lane_policies[0].policy.task.name, [FIRST_EVAL_SEED + lane.eval_seed for lane in lanes])
    try:
        return _run(world, lane_policies, steps, progress)
    finally:
        world.close()


def _run(world: World, lane_policies: Sequence[LanePolicy], steps: int, progress: ProgressCallback) -> LaneRecords:
    loop = ClosedLoop(world, lane_policies)
    recorder = _Recorder(loop, lane_policies, steps, world.spec.hides_divergence)
    with one_thread():
        for step in range(1, steps + 1):
            recorder.take(step)
            if step % 500 == 0:
                progress(step, len(loop.running))
            if not len(loop.running):
                break
    return recorder.records()


class _Recorder:
    """Accumulates the fields of LaneRecords while the loop runs."""

    def __init__(
        self, loop: ClosedLoop, lane_policies: Sequence[LanePolicy], steps: int, hides_divergence: bool
    ) -> None:
        n = len(lane_policies)
        self._loop = loop
        self._steps = recorded_steps(steps)
        self._next = 0
        self._returns = np.zeros((n, len(self._steps)))
        self._total = np.zeros(n)
        self._end_step, self._reason = np.full(n, steps), np.full(n, SURVIVED)
        self._divergence = DivergenceDetector(
            loop.observations, np.stack([each.policy.observation_std for each in lane_policies]), hides_divergence
        )
        self._movement = MovementRecorder([each.policy for each in lane_policies], steps)

    def take(self, step: int) -> None:
        """Advance the loop to step ``step`` and record the results."""
        lane_step = self._loop.advance()
        lanes, result = lane_step.lanes, lane_step.step
        rewards = result.rewards
        diverged = self._divergence.diverged(lane_step)
        if diverged.any():
            # The jump back to the start state yields a reward that does not count.
            rewards = np.where(diverged, 0.0, rewards)
            self._loop.drop(lanes[diverged])
        self._total[lanes] += rewards
        self._movement.take(lane_step, step)
        ended = result.ended | diverged
        if ended.any():
            self._end(lanes[ended], step, result.terminated[ended], diverged[ended])
        if step == self._steps[self._next]:
            self._returns[:, self._next] = self._total
            self._next += 1

    def _end(
        self,
        lanes: NDArray[np.int64],
        step: int,
        terminated: NDArray[np.bool_],
        diverged: NDArray[np.bool_],
    ) -> None:
        self._end_step[lanes] = step
        self._reason[lanes] = np.where(diverged, DIVERGED, np.where(terminated, TERMINATED, TRUNCATED))

    def records(self) -> LaneRecords:
        """Return the records; lanes that all ended early keep their values at the recorded steps not reached."""
        if self._next < len(self._steps):
            self._returns[:, self._next :] = self._total[:, None]
        return LaneRecords(
            steps=self._steps,
            returns=self._returns,
            end_step=self._end_step,
            end_reason=self._reason,
            end_detail=[self._detail(lane) for lane in range(len(self._total))],
            movement=self._movement.movement,
        )

    def _detail(self, lane: int) -> str:
        parts = [self._divergence.signs[lane]] if self._reason[lane] == DIVERGED else []
        if step := int(self._movement.left_step[lane]):
            component = self._movement.left_component[lane]
            parts.append(f"observation[{component}] left its training range at step {step:,}")
        return "; ".join(parts)
