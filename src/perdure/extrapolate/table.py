"""Convert lane records to the table ``perdure.extrapolation`` that reports read; see ``perdure.report.schema``.

`lane_table` makes the table of lanes. `judge_table` adds verdicts once the idle rate is known.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

from perdure.extrapolate.evaluate import END_REASONS, SURVIVED, LaneRecords
from perdure.extrapolate.lanes import LaneSpec
from perdure.extrapolate.recorded_steps import window_steps
from perdure.extrapolate.score import ScoreScale
from perdure.extrapolate.verdict import judge_lane
from perdure.policy import PolicyLike

if TYPE_CHECKING:
    import polars as pl


def method_label(policy: PolicyLike, default: str) -> str:
    """Return how tables call a policy: its method, and its preset if that is not the usual one; "ppo (cleanrl)"."""
    method, preset = str(policy.provenance.get("method", default)), policy.provenance.get("preset")
    return f"{method} ({preset})" if preset else method


def train_seed(policy: PolicyLike) -> int:
    """Return the training seed of a policy as tables have it; 0 where it is unknown."""
    return int(policy.provenance.get("seed", 0))


def lane_table(
    labels: Sequence[str], policies: Sequence[PolicyLike], lanes: Sequence[LaneSpec], records: LaneRecords, steps: int
) -> pl.DataFrame:
    """Return one row for each lane and recorded step.

    Args:
        labels: Name of each policy.
        policies: `LaneSpec.policy` is an index into them.
        lanes: The lanes of ``records``, in their order.
        records: Their results.
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


def _lane_row(label: str, policy: PolicyLike, lane: LaneSpec) -> dict[str, object]:
    clock = lane.clock
    return {
        "policy": label,
        "method": str(policy.provenance.get("method", "unknown")),
        "task": policy.task.name,
        "train_seed": train_seed(policy),
        "train_horizon": float(policy.training_horizon),
        "clock": "none" if clock is None else clock.label,
        "clock_kind": "none" if clock is None else clock.name,
        "clock_steps": math.nan if clock is None else float(clock.steps),
        "eval_seed": lane.eval_seed,
    }


def judge_table(frame: pl.DataFrame, score_scales: Sequence[ScoreScale]) -> pl.DataFrame:
    """Add the score scale of each lane's policy, and the verdict on each lane.

    Args:
        frame: As `lane_table` makes it, lane after lane.
        score_scales: The measure of each lane's policy, in the order of the lanes.
    """
    import polars as pl

    each = frame["step"].n_unique()
    lanes = frame.select("end_step", "end_reason").gather_every(each, each - 1)
    grid = frame["step"][:each].to_numpy()
    steps = window_steps(int(frame["test_horizon"][0]))
    returns = frame["return"].to_numpy().reshape(-1, each)[:, np.isin(grid, steps)]
    rows = []
    for earned, (end_step, end_reason), scale in zip(returns, lanes.iter_rows(), score_scales, strict=True):
        verdict = judge_lane(steps, earned, end_step, end_reason, scale)
        rows.append({name: getattr(scale, field) for name, field in YARDSTICK.items()} | asdict(verdict))
    added = pl.DataFrame(rows)
    return frame.hstack(added[np.repeat(np.arange(len(rows)), each)])


YARDSTICK = {
    "idle_rate": "idle",
    "reference_rate": "reference",
    "level_rate": "task",
    "window": "window",
    "policy_state": "state",
    "policy_note": "note",
}
"""Columns of the table that hold fields of `ScoreScale`."""
