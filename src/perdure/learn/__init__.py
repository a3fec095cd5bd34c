"""Training: PPO as in Stable-Baselines3 with a configurable horizon, in runs that resume after a kill."""

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
    if name in ("train", "TrainRun"):
        from perdure.learn import run

        return getattr(run, name)
    if name in ("Report", "on_report"):
        from perdure.learn import progress

        return getattr(progress, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
