"""PPO as in Stable-Baselines3, with the horizon as a setting of its own, compiled to one program an iteration.

| file | what it holds |
|---|---|
| `config.py`, `presets.py`, `methods.py` | settings; tuned numbers for each task with their source; methods |
| `networks.py`, `normalizer.py` | policy and value network; running normalization |
| `rollout.py` | collecting experience inside one compiled loop |
| `iteration.py` | one iteration, top to bottom: rollout, advantages, epochs |
| `estimators/`, `update.py` | how advantages are estimated; loss and Adam |
| `segment.py`, `state.py`, `checkpoint.py` | a run as a chain of segments that survives kill -9 |
| `training.py`, `export.py` | training runs, and the files they leave |
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
    """Loads the learner, and with it JAX, only when it is asked for."""
    if name in ("train", "TrainRun", "Report", "on_report"):
        from perdure.ppo import training as module

        return getattr(module, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
