"""PPO as in Stable-Baselines3, with a configurable horizon; each iteration is one compiled JAX program.

| file | what it holds |
|---|---|
| `config.py`, `presets.py`, `methods.py` | settings; tuned hyperparameters of each task with their source; methods |
| `networks.py`, `normalizer.py` | policy and value network; running normalization |
| `rollout.py` | experience collection in one compiled loop |
| `iteration.py` | one iteration: rollout, advantages, epochs |
| `estimators/`, `update.py` | advantage estimators; loss and Adam |
| `segment.py`, `state.py`, `checkpoint.py` | segments and checkpoints: a killed run resumes |
| `training.py`, `export.py` | training runs, and the files they write |
| `tensorboard.py` | learning curves for TensorBoard |
| `errors.py` | `ConfigError`, `CheckpointError` |
"""

from perdure.ppo.config import PPOConfig
from perdure.ppo.errors import CheckpointError, ConfigError
from perdure.ppo.methods import METHODS, Method, default_clock, method_config

__all__ = [
    "METHODS",
    "CheckpointError",
    "ConfigError",
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
        from perdure.ppo import training as module

        return getattr(module, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
