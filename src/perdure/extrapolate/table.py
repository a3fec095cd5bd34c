"""From lane records to the table ``perdure.extrapolation`` that reports read; see ``perdure.report.schema``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from perdure.extrapolate.evaluate import END_REASONS, SURVIVED, LaneRecords
from perdure.extrapolate.lanes import LaneSpec
from perdure.policy import Policy

if TYPE_CHECKING:
    import polars as pl


def lane_table(
    labels: Sequence[str], policies: Sequence[Policy], lanes: Sequence[LaneSpec], records: LaneRecords, steps: int
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
        "stuck_steps": records.stuck_steps.ravel(),
        "first_tenth": np.repeat(records.first_tenth, m),
        "last_tenth": np.repeat(records.last_tenth, m),
    }
    return pl.DataFrame(columns)


def _lane_row(label: str, policy: Policy, lane: LaneSpec) -> dict[str, object]:
    clock = lane.clock
    return {
        "policy": label,
        "method": str(policy.provenance.get("method", "unknown")),
        "task": policy.task.name,
        "train_seed": int(policy.provenance.get("seed", 0)),
        "train_horizon": float(policy.protocol.horizon.longest),
        "clock": "none" if clock is None else clock.label,
        "clock_kind": "none" if clock is None else clock.name,
        "clock_steps": math.nan if clock is None else float(clock.steps),
        "eval_seed": lane.eval_seed,
    }
