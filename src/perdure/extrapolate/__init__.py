"""Closed-loop evaluation far beyond the training horizon.

| file | what it holds |
|---|---|
| `lanes.py` | what is evaluated: policies x clocks x start states |
| `evaluate.py` | carrying lanes along and writing down what becomes of them |
| `checkpoints.py` | at which steps |
| `divergence.py` | detecting simulations that diverged |
| `idle.py`, `score.py`, `verdict.py`, `movement.py` | an idle robot's reward, scores, verdict of a lane |
| `run.py` | groups of lanes over the cores, resumable |
| `table.py`, `result.py` | the Parquet table, the typed result |
| `errors.py` | `ExtrapolationError` |
"""

from perdure.extrapolate.errors import ExtrapolationError
from perdure.extrapolate.evaluate import LaneRecords, evaluate_lanes
from perdure.extrapolate.lanes import Extrapolation, LaneSpec
from perdure.extrapolate.result import ExtrapolationResult
from perdure.extrapolate.run import extrapolate

__all__ = [
    "Extrapolation",
    "ExtrapolationError",
    "ExtrapolationResult",
    "LaneRecords",
    "LaneSpec",
    "evaluate_lanes",
    "extrapolate",
]
