"""Tuned PPO hyperparameters for each task, with their sources.

All but the last two rows are the PPO entries of RL Baselines3 Zoo (DLR-RM/rl-baselines3-zoo, ``hyperparams/ppo.yml`` at
22e3ff2, 2026-04), whose entries carried the names ``*-v3`` until 2024-01 and did not change when they were renamed.
The zoo trains all six with ``normalize: true``: observations and rewards, with the reward normalizer's gamma equal to
the algorithm's.

| task | gamma | envs | steps | batch | epochs | lambda | step size | network | total steps | from |
|---|---|---|---|---|---|---|---|---|---|---|
| HalfCheetah | 0.98 | 1 | 512 | 64 | 20 | 0.92 | 2.0633e-5 | 256, 256 relu | 1e6 | zoo, tuned (#155, #183) |
| Hopper | 0.999 | 1 | 512 | 32 | 5 | 0.99 | 9.80828e-5 | 256, 256 relu | 1e6 | zoo, tuned (#155, #183) |
| Walker2d | 0.99 | 1 | 512 | 32 | 20 | 0.95 | 5.05041e-5 | 64, 64 tanh | 1e6 | zoo, tuned; the zoo names no network |
| Humanoid | 0.95 | 1 | 512 | 256 | 5 | 0.9 | 3.56987e-5 | 256, 256 relu | 1e7 | zoo, tuned |
| Swimmer | 0.9999 | 4 | 1024 | 256 | 10 | 0.98 | 6e-4 | 64, 64 tanh | 1e6 | zoo, tuned (#335, 2023-01) |
| Ant | 0.99 | 1 | 2048 | 64 | 10 | 0.95 | 3e-4 | 64, 64 tanh | 1e6 | zoo's entry is SB3's defaults |
| any other | 0.99 | 1 | 2048 | 64 | 10 | 0.95 | 3e-4 | 64, 64 tanh | 1e6 | Stable-Baselines3's defaults |

The zoo holds a tuned entry for Ant that is commented out (10 million steps); "tuned" values for Ant do not exist there.
Before 2023-01 it trained Swimmer with defaults and gamma = 0.9999.

With the zoo's Hopper settings policies of Stable-Baselines3 and of perdure learn to stand still (rl-baselines3-zoo's
issue 376 reports the same). So a second preset, ``cleanrl``, has one set of numbers for every task: those of CleanRL's
``ppo_continuous_action.py`` (Huang et al., 2022), which are Stable-Baselines3's defaults with a step size that falls
linearly to 0. CleanRL also clips the value loss, normalizes with other clipping and counts a time limit as the task's
end; these are not hyperparameters here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

from perdure.horizon.geometric import robot_of
from perdure.ppo.errors import ConfigError

DEFAULT_GAMMA = 0.99
"""Stable-Baselines3's."""


@dataclass(frozen=True)
class Preset:
    """Tuned gamma, and the fields of :class:`~perdure.ppo.config.PPOConfig` that differ from its defaults."""

    gamma: float
    settings: dict[str, Any]


_WIDE = {"hidden_sizes": (256, 256), "activation": "relu", "log_std_init": -2.0, "ortho_init": False}

ZOO = "zoo"
"""The preset that is used when none is named."""

_ZOO: dict[str, Preset] = {
    "HalfCheetah": Preset(
        0.98,
        {
            "n_steps": 512,
            "batch_size": 64,
            "n_epochs": 20,
            "gae_lambda": 0.92,
            "learning_rate": 2.0633e-5,
            "ent_coef": 4.01762e-4,
            "clip_range": 0.1,
            "max_grad_norm": 0.8,
            "vf_coef": 0.58096,
            **_WIDE,
        },
    ),
    "Hopper": Preset(
        0.999,
        {
            "n_steps": 512,
            "batch_size": 32,
            "n_epochs": 5,
            "gae_lambda": 0.99,
            "learning_rate": 9.80828e-5,
            "ent_coef": 2.29519e-3,
            "clip_range": 0.2,
            "max_grad_norm": 0.7,
            "vf_coef": 0.835671,
            **_WIDE,
        },
    ),
    "Walker2d": Preset(
        0.99,
        {
            "n_steps": 512,
            "batch_size": 32,
            "n_epochs": 20,
            "gae_lambda": 0.95,
            "learning_rate": 5.05041e-5,
            "ent_coef": 5.85045e-4,
            "clip_range": 0.1,
            "max_grad_norm": 1.0,
            "vf_coef": 0.871923,
        },
    ),
    "Humanoid": Preset(
        0.95,
        {
            "n_steps": 512,
            "batch_size": 256,
            "n_epochs": 5,
            "gae_lambda": 0.9,
            "learning_rate": 3.56987e-5,
            "ent_coef": 2.38306e-3,
            "clip_range": 0.3,
            "max_grad_norm": 2.0,
            "vf_coef": 0.431892,
            "total_steps": 10_000_000,
            # Humanoid steps slowly: shorter segments keep what a kill can cost under a minute.
            "segment_steps": 20_000,
            **_WIDE,
        },
    ),
    "Swimmer": Preset(
        0.9999,
        {
            "n_envs": 4,
            "n_steps": 1024,
            "batch_size": 256,
            "gae_lambda": 0.98,
            "learning_rate": 6e-4,
        },
    ),
    "Ant": Preset(0.99, {}),
}


_DEFAULTS = Preset(DEFAULT_GAMMA, {})
_CLEANRL = Preset(DEFAULT_GAMMA, {"learning_rate_decay": "linear"})

PRESETS: dict[str, Callable[[str], Preset]] = {
    ZOO: lambda robot: _ZOO.get(robot, _DEFAULTS),
    "cleanrl": lambda robot: _CLEANRL,
}
"""Name to what makes the preset of a robot, such as "Hopper"."""


def find_preset(task: str, name: str = ZOO) -> Preset:
    """Return the hyperparameters of a task in any of its versions ("Hopper-v3", "gymnasium:Hopper-v5").

    Raises:
        ConfigError: If there is no preset of that name.
    """
    if name not in PRESETS:
        near = get_close_matches(name, PRESETS, n=1)
        hint = f" (did you mean {near[0]!r}?)" if near else ""
        raise ConfigError(f"unknown preset {name!r}{hint}; the presets are {', '.join(PRESETS)}")
    return PRESETS[name](robot_of(task))
