"""Closed-loop evaluation far beyond the training horizon."""

from perdure.evaluate.episodes import EpisodeRecords, EpisodeSpec, Extrapolation, evaluate_episodes
from perdure.evaluate.run import extrapolate
from perdure.evaluate.stored import evaluate_files
from perdure.evaluate.table import ExtrapolationResult

__all__ = [
    "EpisodeRecords",
    "EpisodeSpec",
    "Extrapolation",
    "ExtrapolationResult",
    "evaluate_episodes",
    "evaluate_files",
    "extrapolate",
]
