"""Closed-loop evaluation far beyond the training horizon.

A lane is one deployed episode: a policy under a clock from a start state.

The package is callable: ``perdure.extrapolate(...)`` calls ``perdure.extrapolate.extrapolate``.

| file | what it holds |
|---|---|
| `lanes.py` | what is evaluated: policies x clocks x start states |
| `evaluate.py` | run lanes and record their results |
| `recorded_steps.py` | the steps at which results are recorded |
| `idle.py`, `score.py`, `verdict.py`, `movement.py` | idle reward rate, scores, verdict of a lane, movement |
| `api.py` | `extrapolate`: evaluate an `Extrapolation` or a single policy |
| `run.py` | evaluation of policy files over several cores, resumable |
| `in_process.py` | evaluation of one policy of any library in this process |
| `baselines.py` | reference and idle reward rates |
| `table.py`, `result.py` | the Parquet table, the typed result |
| `card.py` | the model card of a policy: a README with its verdict |
| `errors.py` | `ExtrapolationError` |
"""

import sys
from types import ModuleType
from typing import Any

from perdure.extrapolate.api import extrapolate
from perdure.extrapolate.errors import ExtrapolationError
from perdure.extrapolate.evaluate import LaneRecords, evaluate_lanes
from perdure.extrapolate.lanes import Extrapolation, LaneSpec
from perdure.extrapolate.result import ExtrapolationResult

__all__ = [
    "Extrapolation",
    "ExtrapolationError",
    "ExtrapolationResult",
    "LaneRecords",
    "LaneSpec",
    "evaluate_lanes",
    "extrapolate",
]


class _Callable(ModuleType):
    def __call__(self, *arguments: Any, **options: Any) -> ExtrapolationResult:
        """See `extrapolate`."""
        return extrapolate(*arguments, **options)


sys.modules[__name__].__class__ = _Callable
