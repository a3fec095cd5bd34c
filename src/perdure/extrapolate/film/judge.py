"""Run and judge episodes in the environment that is filmed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from perdure.envs import OpenEnv
from perdure.extrapolate import LaneSpec, evaluate_lanes
from perdure.extrapolate.baselines import idle_baseline, with_reference
from perdure.extrapolate.film.errors import FilmError
from perdure.extrapolate.lanes import FIRST_EVAL_SEED
from perdure.extrapolate.score import ScoreScale, make_score_scale, task_rate
from perdure.extrapolate.table import judge_table, lane_table
from perdure.horizon import Clock
from perdure.policy import Policy

FAILURES = ("falls", "fails silently", "decays", "diverges")


@dataclass(frozen=True, eq=False)
class JudgedLane:
    """One episode and its outcome."""

    clock: Clock | None
    eval_seed: int
    outcome: str
    """As in the table: "holds", "falls", ..."""
    failed_step: int
    """Steps completed before the failure began; without a failure, all steps of the episode."""
    end_step: int
    total: float
    """Its return."""

    @property
    def failed(self) -> bool:
        """Whether it falls, diverges, decays or fails silently."""
        return self.outcome in FAILURES


class Judge:
    """Judges episodes of one policy; also measures its episodes within the training horizon."""

    def __init__(self, policy: Policy, source: OpenEnv, steps: int) -> None:
        """Measure idle robots and the policy itself.

        Args:
            policy: The policy.
            source: The environment.
            steps: Length of each episode in steps, if nothing ends it earlier.
        """
        # The stored reference may have been measured with another engine.
        measured = with_reference(replace(policy, reference=None), source)
        assert isinstance(measured, Policy)
        assert measured.reference is not None
        self.policy, self._source, self._steps = measured, source, steps
        self.scale: ScoreScale = make_score_scale(
            measured.reference, idle_baseline(source), task_rate(policy.task.name)
        )

    def judge(self, clock: Clock | None, eval_seeds: Sequence[int]) -> list[JudgedLane]:
        """Run one episode from each start state."""
        lanes = [LaneSpec(0, clock, seed) for seed in eval_seeds]
        world = self._source.make([FIRST_EVAL_SEED + seed for seed in eval_seeds])
        try:
            records = evaluate_lanes([self.policy], lanes, self._steps, world=world)
        finally:
            world.close()
        frame = judge_table(
            lane_table(["policy"], [self.policy], lanes, records, self._steps), [self.scale] * len(lanes)
        )
        return [
            JudgedLane(clock, row["eval_seed"], row["outcome"], row["failed_step"], row["end_step"], row["return"])
            for row in frame.filter(frame["step"] == self._steps).iter_rows(named=True)
        ]

    def first_failure(self, clock: Clock | None, eval_seeds: Sequence[int]) -> JudgedLane:
        """Return the first of these episodes that fails.

        Raises:
            FilmError: If none does.
        """
        for lane in self.judge(clock, eval_seeds):
            if lane.failed:
                return lane
        raise FilmError(
            f"none of {len(eval_seeds)} episodes of {self._steps:,} steps fails under "
            f"{'no clock' if clock is None else clock.label}; ask for more --steps or --eval-seeds, or another --clock"
        )
