"""Closed-loop evaluation far beyond the training horizon.

This package can be called: ``perdure.extrapolate(...)`` is ``perdure.extrapolate.extrapolate(...)``.

| file | what it holds |
|---|---|
| `lanes.py` | what is evaluated: policies x clocks x start states |
| `evaluate.py` | carrying lanes along and writing down what becomes of them |
| `checkpoints.py` | at which steps |
| `divergence.py` | detecting simulations that diverged |
| `idle.py`, `score.py`, `verdict.py`, `movement.py` | an idle robot's reward, scores, verdict of a lane |
| `door.py` | `extrapolate`, for an `Extrapolation` or one policy of any origin |
| `run.py` | groups of lanes over the cores, resumable |
| `in_process.py`, `measured.py` | one policy of any origin in this process |
| `table.py`, `result.py` | the Parquet table, the typed result |
| `card.py` | the model card of a policy |
| `errors.py` | `ExtrapolationError` |
"""

import sys
from types import ModuleType
from typing import Any

from perdure.extrapolate.door import extrapolate
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
