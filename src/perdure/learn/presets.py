"""Tuned PPO hyperparameters for each task with their sources, and the training methods.

The rows of `_ZOO` are the PPO entries of RL Baselines3 Zoo (DLR-RM/rl-baselines3-zoo, ``hyperparams/ppo.yml`` at
22e3ff2, 2026-04), whose entries carried the names ``*-v3`` until 2024-01 and did not change when they were renamed.
The zoo trains all six with ``normalize: true``: observations and rewards, with the reward normalizer's gamma equal to
the algorithm's.

HalfCheetah and Hopper come from its pull requests 155 and 183, Swimmer from 335 (before 2023-01: defaults and gamma =
0.9999). For Walker2d it names no network. Its entry for Ant is Stable-Baselines3's defaults, as here for any other
task; a tuned one (10 million steps) is commented out. Here Ant also starts with less noise, log_std_init -1 in place of
0: with 0 its first steps earn less than nothing, and undiscounted methods learn to end episodes
(`perdure.learn.first_rollout`). Policies of Ant that were trained before name log_std_init 0 in their settings.

With the zoo's Hopper settings policies of Stable-Baselines3 and of perdure learn to stand still (rl-baselines3-zoo's
issue 376 reports the same). So a second preset, ``cleanrl``, has one set of numbers for every task: those of CleanRL's
``ppo_continuous_action.py`` (Huang et al., 2022), which are Stable-Baselines3's defaults with a step size that falls
linearly to 0. CleanRL also clips the value loss, normalizes with other clipping and counts a time limit as the task's
end; these are not hyperparameters here. `perdure.horizon.usual_preset` says which preset a task has by default.

| method | gamma | horizon T | at T | phi | what it is |
|---|---|---|---|---|---|
| ``ppo`` | tuned | 1000 | bootstrap last observation | - | Stable-Baselines3's PPO (>= 1.4) with rl-zoo's settings |
| ``steady`` | tuned, then 0.999 | 1000 | bootstrap last observation | - | ``ppo``, then further under action noise |
| ``ppo-undiscounted`` | 1 | 1000 | bootstrap last observation | - | baseline; values determined only up to a constant |
| ``ppo-undiscounted-terminal`` | 1 | 1000 | terminal | - | the same with determined values: V = 0 at T |
| ``ppo-short`` | tuned | 200 | bootstrap last observation | - | short episodes (figure 3-1 of the thesis) |
| ``linear`` | tuned | 1000 | terminal | Linear | Pardo et al., Time limits in reinforcement learning (2018) |
| ``linear-10-workers`` | tuned | 1000 | terminal | Linear | 10 environments, each for the preset's n_steps |
| ``geometric`` | 1 | U[200, 1000] | terminal | Geometric(d) | the thesis |
| ``random-horizon`` | 1 | U[200, 1000] | terminal | - | control: random T without phi |
| ``geometric-fixed`` | 1 | 1000 | terminal | Geometric(d) | control: phi without random T |
| ``ppo-average-reward`` | 1 | 1000 | bootstrap last observation | - | reward per step; a fall is a cost, not an end |
| ``linear-random`` | 1 | U[200, 1000] | terminal | Linear | control: linear phi with random T |
| ``geometric-5`` | 1 | U[200, 1000] | terminal | Geometric(5) | ``geometric`` with five numbers on every task |
| ``geometric-10`` | 1 | U[200, 1000] | terminal | Geometric(10) | ``geometric`` with ten numbers on every task |
| ``geometric-film`` | 1 | U[200, 1000] | terminal | Geometric(d) | ``geometric``; phi scales and shifts hidden layers |

``steady`` trains ``ppo`` and, in the same run, trains its policy further (`perdure.learn.recipe`).

With gamma = 1 and a bootstrap at every time limit, values are determined only up to a constant and may drift. The
baseline still learns, because advantages use differences of V.

The reward normalizer's gamma is the task's tuned gamma in every method, also where gamma = 1. rl-zoo would copy
gamma = 1 into it. Rewards would then be divided by the spread of whole episodes' returns, far from the scale at which
the other settings were tuned. ``--ppo.protocol.normalizer-gamma 1`` restores rl-zoo's behavior.

Evaluation uses the mean of the Gaussian and the final weights. The thesis specifies neither.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from perdure.errors import lookup
from perdure.horizon import (
    Clock,
    Constant,
    Embedding,
    Fixed,
    Geometric,
    HorizonDistribution,
    HorizonProtocol,
    Linear,
    Uniform,
    geometric_size,
    robot_of,
    usual_preset,
)
from perdure.learn.config import Conditioning, Further, PPOConfig


@dataclass(frozen=True)
class Preset:
    """Tuned gamma, and the fields of :class:`~perdure.learn.config.PPOConfig` that differ from its defaults."""

    gamma: float
    settings: dict[str, Any]


ZOO = "zoo"
_COLUMNS = (
    *("n_steps", "batch_size", "n_epochs", "gae_lambda", "learning_rate"),
    *("ent_coef", "clip_range", "max_grad_norm", "vf_coef"),
)
_WIDE = {"hidden_sizes": (256, 256), "activation": "relu", "log_std_init": -2.0, "ortho_init": False}
# Humanoid steps slowly: shorter segments keep what a kill can cost under a minute.
_LONG = {"total_steps": 10_000_000, "segment_steps": 20_000}


def _tuned(gamma: float, *values: float, **others: Any) -> Preset:
    return Preset(gamma, {**dict(zip(_COLUMNS, values, strict=True)), **others})


_ZOO = {
    "HalfCheetah": _tuned(0.98, 512, 64, 20, 0.92, 2.0633e-5, 4.01762e-4, 0.1, 0.8, 0.58096, **_WIDE),
    "Hopper": _tuned(0.999, 512, 32, 5, 0.99, 9.80828e-5, 2.29519e-3, 0.2, 0.7, 0.835671, **_WIDE),
    "Walker2d": _tuned(0.99, 512, 32, 20, 0.95, 5.05041e-5, 5.85045e-4, 0.1, 1.0, 0.871923),
    "Humanoid": _tuned(0.95, 512, 256, 5, 0.9, 3.56987e-5, 2.38306e-3, 0.3, 2.0, 0.431892, **_WIDE, **_LONG),
    "Swimmer": _tuned(0.9999, 1024, 256, 10, 0.98, 6e-4, 0.0, 0.2, 0.5, 0.5, n_envs=4),
}
TUNED = tuple(_ZOO)
"""Robots that have a row of their own in the Zoo's preset. Ant has Stable-Baselines3's defaults there, as any other."""
_DEFAULTS = Preset(0.99, {})
_QUIET = {"Ant": Preset(0.99, {"log_std_init": -1.0})}
"""Robots that have the defaults, but less noise at the start."""
_CLEANRL = Preset(0.99, {"learning_rate_decay": "linear"})

PRESETS: dict[str, Callable[[str], Preset]] = {
    ZOO: lambda robot: (_ZOO | _QUIET).get(robot, _DEFAULTS),
    "cleanrl": lambda robot: _CLEANRL,
}
"""Name to what makes the preset of a robot, such as "Hopper"."""


EPISODE_STEPS = 1000
"""Training horizon where the environment has no step limit of its own. The methods' horizons are written for it."""
EPISODE = Fixed(EPISODE_STEPS)
SHORT_EPISODE = Fixed(200)
RANDOM_EPISODE = Uniform(200, EPISODE_STEPS)
DEPLOYED_STEPS_TO_GO = 500
"""Largest C of the default clock."""


@dataclass(frozen=True)
class Method:
    """One row of the table of methods."""

    horizon: HorizonDistribution
    terminal: bool
    """Whether reaching T is terminal; otherwise the last observation is bootstrapped."""
    undiscounted: bool = False
    embedding: Callable[[int, str], Embedding] | None = None
    """Makes phi from (observation size, task)."""
    n_envs: int | None = None
    """Environments side by side; None: those of the preset."""
    estimator: str = "discounted"
    conditioning: Conditioning = "concatenate"
    then: Further | None = None
    """Training that follows in the same run."""


def _geometric(observation_size: int, task: str) -> Embedding:
    return Geometric(geometric_size(observation_size, task))


METHODS: dict[str, Method] = {
    "ppo": Method(EPISODE, terminal=False),
    "steady": Method(EPISODE, terminal=False, then=Further()),
    "ppo-undiscounted": Method(EPISODE, terminal=False, undiscounted=True),
    "ppo-undiscounted-terminal": Method(EPISODE, terminal=True, undiscounted=True),
    "ppo-short": Method(SHORT_EPISODE, terminal=False),
    "linear": Method(EPISODE, terminal=True, embedding=lambda *_: Linear()),
    "linear-10-workers": Method(EPISODE, terminal=True, embedding=lambda *_: Linear(), n_envs=10),
    "geometric": Method(RANDOM_EPISODE, terminal=True, undiscounted=True, embedding=_geometric),
    "random-horizon": Method(RANDOM_EPISODE, terminal=True, undiscounted=True),
    "geometric-fixed": Method(EPISODE, terminal=True, undiscounted=True, embedding=_geometric),
    "ppo-average-reward": Method(EPISODE, terminal=False, undiscounted=True, estimator="average-reward"),
    "linear-random": Method(RANDOM_EPISODE, terminal=True, undiscounted=True, embedding=lambda *_: Linear()),
    "geometric-5": Method(RANDOM_EPISODE, terminal=True, undiscounted=True, embedding=lambda *_: Geometric(5)),
    "geometric-10": Method(RANDOM_EPISODE, terminal=True, undiscounted=True, embedding=lambda *_: Geometric(10)),
    "geometric-film": Method(
        RANDOM_EPISODE, terminal=True, undiscounted=True, embedding=_geometric, conditioning="film"
    ),
}


def method_config(
    method: str, task: str, observation_size: int, preset: str | None = None, limit: int = EPISODE_STEPS
) -> PPOConfig:
    """Return the full configuration of a method on a task.

    Args:
        method: A key of METHODS.
        task: The task's name, as in `perdure list tasks`.
        observation_size: Length of its observations; phi's size follows from it.
        preset: A key of `perdure.learn.presets.PRESETS`: the set of hyperparameters; None: `usual_preset` of the task.
        limit: Steps after which an episode of the environment ends; the horizons of the methods scale with it.

    Raises:
        PerdureError: If there is no such method or preset.
    """
    chosen = lookup(METHODS, method, "method")
    tuned = lookup(PRESETS, preset or usual_preset(task), "preset")(robot_of(task))
    embedding = None
    if chosen.embedding is not None:
        embedding = chosen.embedding(observation_size, task)
    # The horizons of the table are written for episodes of EPISODE_STEPS.
    whole = {name: value for name, value in vars(chosen.horizon).items() if isinstance(value, int)}
    steps = {name: max(1, value * limit // EPISODE_STEPS) for name, value in whole.items()}
    protocol = HorizonProtocol(
        embedding=embedding,
        horizon=type(chosen.horizon)(**vars(chosen.horizon) | steps),
        end="terminated" if chosen.terminal else "truncated",
        gamma=1.0 if chosen.undiscounted else tuned.gamma,
        normalizer_gamma=tuned.gamma,
    )
    config = PPOConfig(
        protocol=protocol,
        estimator=chosen.estimator,
        conditioning=chosen.conditioning,
        then=chosen.then,
        **tuned.settings,
    )
    if chosen.n_envs is not None:
        config = dataclasses.replace(config, n_envs=chosen.n_envs)
    return config


def default_clock(config: PPOConfig) -> Clock | None:
    """Return the clock of a policy of this configuration: Constant(min(500, half its longest training horizon)).

    Half, so that C is far from the end that the policy saw in training. None without an embedding.
    """
    if config.protocol.embedding is None:
        return None
    return Constant(min(DEPLOYED_STEPS_TO_GO, config.protocol.horizon.longest / 2))
