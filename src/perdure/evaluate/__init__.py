"""Closed-loop evaluation far beyond the training horizon."""

from perdure.evaluate.episodes import EpisodeRecords, EpisodeSpec, evaluate_episodes
from perdure.evaluate.options import Extrapolation
from perdure.evaluate.run import evaluate_files, extrapolate
from perdure.evaluate.table import ExtrapolationResult
from perdure.evaluate.units import Execution

__all__ = [
    "EpisodeRecords",
    "EpisodeSpec",
    "Execution",
    "Extrapolation",
    "ExtrapolationResult",
    "evaluate_episodes",
    "evaluate_files",
    "extrapolate",
]
