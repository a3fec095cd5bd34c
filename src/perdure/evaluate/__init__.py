"""Closed-loop evaluation far beyond the training horizon."""

from perdure.evaluate.episodes import EpisodeRecords, EpisodeSpec, evaluate_episodes
from perdure.evaluate.options import Extrapolation
from perdure.evaluate.run import evaluate_files, extrapolate
from perdure.evaluate.stored import Execution
from perdure.evaluate.table import ExtrapolationResult

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
