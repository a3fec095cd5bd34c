"""What a table says, for machines: one JSON document, and which groups do not hold."""

from __future__ import annotations

import json
import math
import platform
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from perdure.report.estimates import Estimate, Estimates
from perdure.report.goals import GOOD, medians
from perdure.runs import versions


def not_holding(estimates: Estimates) -> list[str]:
    """Return who does not hold, such as "ppo: falls in 4 of 10 episodes", or why it cannot tell."""
    verdicts = [item.verdict for items in estimates.values() for item in items]
    found = [verdict for verdict in verdicts if verdict.label not in GOOD]
    return [each.sentence.rstrip(".") if each.label == "cannot tell" else each.short for each in found]


def summary_json(estimates: Estimates, table: Path, page: Path) -> str:
    """Return the summary of a table and its report as JSON; docs/reference/table.md describes its names."""
    document = {
        "holds": not not_holding(estimates),
        "groups": [_group(item) for items in estimates.values() for item in items],
        "table": str(table.resolve()),
        "page": str(page.resolve()),
        "versions": {"python": platform.python_version(), **versions("envpool", "gymnasium", "mujoco", "numpy")},
    }
    return json.dumps(document, indent=2, allow_nan=False)


def _group(item: Estimate) -> dict[str, Any]:
    group, share = item.group, item.verdict.share
    rate = group.failure_rate
    hourly = None if rate is None else _numbers(estimate=rate.per_hour, low=rate.lower, high=rate.upper)
    return {
        "task": group.task,
        "policy": group.line.removesuffix(f" under {group.disturbance}"),
        "clock": group.clock,
        "disturbance": group.disturbance,
        "episodes": group.episodes,
        "steps": group.test_horizon,
        "verdict": item.verdict.label,
        "outcomes": dict(Counter(group.verdicts)),
        "share_that_holds": _numbers(estimate=share.estimate, low=share.lower, high=share.upper),
        "mean_return": _numbers(estimate=item.returns.estimate, low=item.returns.lower, high=item.returns.upper),
        **_numbers(median_failure_step=group.half_failed_by),
        "failures_per_hour": hourly,
        "measures": medians(group),
    }


def _numbers(**values: Any) -> dict[str, float | None]:
    """Return the last number of each value; None where it is unknown."""
    last = {name: float(np.ravel(value)[-1]) for name, value in values.items()}
    return {name: value if math.isfinite(value) else None for name, value in last.items()}
