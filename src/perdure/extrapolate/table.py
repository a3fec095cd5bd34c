"""From lane records to the table ``perdure.extrapolation`` that reports read; see ``perdure.report.schema``.

Facts of lanes come first, from `lane_table`; verdicts are added by `judge_table`, when it is known what an idle robot
earns.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from perdure.extrapolate.checkpoints import window_steps
from perdure.extrapolate.evaluate import END_REASONS, SURVIVED, LaneRecords
from perdure.extrapolate.lanes import LaneSpec
from perdure.extrapolate.score import ScoreScale
from perdure.extrapolate.verdict import LaneVerdict, judge_lane
from perdure.policy import Actor

if TYPE_CHECKING:
    import polars as pl


def lane_table(
    labels: Sequence[str], policies: Sequence[Actor], lanes: Sequence[LaneSpec], records: LaneRecords, steps: int
) -> pl.DataFrame:
    """One row for each lane and checkpoint.

    Args:
        labels: Name of each policy.
        policies: What the lanes' numbers refer to.
        lanes: The lanes of ``records``, in their order.
        records: What became of them.
        steps: The test horizon.
    """
    import polars as pl

    n, m = records.returns.shape
    rows = [_lane_row(labels[lane.policy], policies[lane.policy], lane) for lane in lanes]
    reached = records.steps[None, :] <= records.end_step[:, None]
    survived = (records.end_reason == SURVIVED)[:, None]
    columns: dict[str, object] = {name: [row[name] for row in rows for _ in range(m)] for name in rows[0]}
    columns |= {
        "test_horizon": np.full(n * m, steps),
        "step": np.tile(records.steps, n),
        "return": records.returns.ravel(),
        # A lane that ended with step s has completed s - 1 steps without ending.
        "alive": (reached & (survived | (records.steps[None, :] < records.end_step[:, None]))).ravel(),
        "end_reason": [END_REASONS[reason] for reason in records.end_reason for _ in range(m)],
        "end_step": np.repeat(records.end_step, m),
        "end_detail": [detail for detail in records.end_detail for _ in range(m)],
        "movement_first": np.repeat(records.movement[0], m),
        "movement_last": np.repeat(records.movement[1], m),
    }
    return pl.DataFrame(columns)


def _lane_row(label: str, policy: Actor, lane: LaneSpec) -> dict[str, object]:
    clock = lane.clock
    return {
        "policy": label,
        "method": str(policy.provenance.get("method", "unknown")),
        "task": policy.task.name,
        "train_seed": int(policy.provenance.get("seed", 0)),
        "train_horizon": float(policy.training_horizon),
        "clock": "none" if clock is None else clock.label,
        "clock_kind": "none" if clock is None else clock.name,
        "clock_steps": math.nan if clock is None else float(clock.steps),
        "eval_seed": lane.eval_seed,
    }


def judge_table(frame: pl.DataFrame, score_scales: Sequence[ScoreScale]) -> pl.DataFrame:
    """Add what each lane's policy is measured with, and the verdict on each lane.

    Args:
        frame: As `lane_table` makes it, lane after lane.
        score_scales: The measure of each lane's policy, in the order of the lanes.
    """
    import polars as pl

    steps = window_steps(int(frame["test_horizon"][0]))
    windows = frame.filter(pl.col("step").is_in(steps.tolist()))
    returns = windows["return"].to_numpy().reshape(-1, len(steps))
    lanes = windows.filter(pl.col("step") == int(steps[-1]))
    verdicts = [
        judge_lane(steps, earned, row["end_step"], row["end_reason"], measure)
        for earned, row, measure in zip(returns, lanes.iter_rows(named=True), score_scales, strict=True)
    ]
    each = len(frame) // len(lanes)
    measures = [measure for measure in score_scales for _ in range(each)]
    columns: dict[str, object] = {
        name: [getattr(measure, field) for measure in measures] for name, field in YARDSTICK.items()
    }
    for name in LaneVerdict.__dataclass_fields__:
        columns[name] = [getattr(verdict, name) for verdict in verdicts for _ in range(each)]
    return frame.hstack(pl.DataFrame(columns))


YARDSTICK = {
    "idle_rate": "idle",
    "reference_rate": "reference",
    "level_rate": "task",
    "window": "window",
    "policy_state": "state",
    "policy_note": "note",
}
"""Columns of the table that hold fields of `ScoreScale`."""
