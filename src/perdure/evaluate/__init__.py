"""Closed-loop evaluation far beyond the training horizon.

| file | what it holds |
|---|---|
| `run.py` | `extrapolate`: a policy of any kind; functions are evaluated in this process |
| `stored.py` | `evaluate_files`: policy files and ONNX models over several cores, resumable |
| `episodes.py` | which episodes are evaluated, how they run, what is recorded of them |
| `reference.py` | reward rates of the policy within its training horizon and of an idle robot |
| `verdict.py` | scores relative to these rates, the verdict of an episode |
| `table.py` | the Parquet table, the typed result |
| `watch.py` | films of a policy as it fails, and stills |
| `card.py` | the model card of a policy: a README with its verdict |
| `callback.py` | a callback that judges the policy while Stable-Baselines3 trains it |
"""

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
