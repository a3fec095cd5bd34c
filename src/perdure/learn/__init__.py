"""PPO as in Stable-Baselines3, with a configurable horizon; each iteration is one compiled JAX program.

| file | what it holds |
|---|---|
| `config.py`, `presets.py`, `methods.py` | settings; tuned hyperparameters of each task with their source; methods |
| `networks.py`, `normalizer.py` | policy and value network; running normalization |
| `rollout.py` | experience collection in one compiled loop |
| `ppo.py` | PPO: one iteration from top to bottom, loss and Adam |
| `estimators/` | advantage estimators |
| `checkpoint.py` | state of a run and its file |
| `run.py` | training runs in segments: a killed run resumes; the files they write |
| `errors.py` | `PerdureError`, `PerdureError` |
"""

from perdure.learn.config import PPOConfig
from perdure.learn.presets import METHODS, Method, default_clock, method_config

__all__ = [
    "METHODS",
    "Method",
    "PPOConfig",
    "Report",
    "TrainRun",
    "default_clock",
    "method_config",
    "on_report",
    "train",
]


def __getattr__(name: str) -> object:
    """Load the training code, and with it JAX, only at its first use."""
    if name in ("train", "TrainRun", "Report", "on_report"):
        from perdure.learn import run as module

        return getattr(module, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
