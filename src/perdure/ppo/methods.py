"""Training methods: each overrides the time settings (gamma, horizon, embedding) of a task's tuned hyperparameters.

| method | gamma | horizon T | at T | phi | what it is |
|---|---|---|---|---|---|
| ``ppo`` | tuned | 1000 | bootstrap last observation | - | Stable-Baselines3's PPO (>= 1.4) with rl-zoo's settings |
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

With gamma = 1 and a bootstrap at every time limit, values are determined only up to a constant and may drift. The
baseline still learns, because advantages use differences of V.

The reward normalizer's gamma is the task's tuned gamma in every method, also where gamma = 1. rl-zoo would copy
gamma = 1 into it. Rewards would then be divided by the spread of whole episodes' returns, far from the scale at which
the other settings were tuned. ``--ppo.protocol.normalizer-gamma 1`` restores rl-zoo's behavior.

Evaluation uses the mean of the Gaussian and the final weights. The thesis specifies neither.
"""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Callable
from dataclasses import dataclass

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
)
from perdure.ppo.config import Conditioning, PPOConfig
from perdure.ppo.errors import ConfigError
from perdure.ppo.presets import ZOO, find_preset

EPISODE = Fixed(1000)
SHORT_EPISODE = Fixed(200)
RANDOM_EPISODE = Uniform(200, 1000)
DEPLOYED_STEPS_TO_GO = 500
"""Largest C of the default clock."""


@dataclass(frozen=True)
class Method:
    """One row of the table. ``embedding`` makes phi from (observation size, task)."""

    horizon: HorizonDistribution
    terminal: bool
    undiscounted: bool = False
    embedding: Callable[[int, str], Embedding] | None = None
    n_envs: int | None = None
    estimator: str = "discounted"
    conditioning: Conditioning = "concatenate"


def _linear(observation_size: int, task: str) -> Embedding:
    return Linear()


def _geometric(observation_size: int, task: str) -> Embedding:
    return Geometric(geometric_size(observation_size, task))


METHODS: dict[str, Method] = {
    "ppo": Method(EPISODE, terminal=False),
    "ppo-undiscounted": Method(EPISODE, terminal=False, undiscounted=True),
    "ppo-undiscounted-terminal": Method(EPISODE, terminal=True, undiscounted=True),
    "ppo-short": Method(SHORT_EPISODE, terminal=False),
    "linear": Method(EPISODE, terminal=True, embedding=_linear),
    "linear-10-workers": Method(EPISODE, terminal=True, embedding=_linear, n_envs=10),
    "geometric": Method(RANDOM_EPISODE, terminal=True, undiscounted=True, embedding=_geometric),
    "random-horizon": Method(RANDOM_EPISODE, terminal=True, undiscounted=True),
    "geometric-fixed": Method(EPISODE, terminal=True, undiscounted=True, embedding=_geometric),
    "ppo-average-reward": Method(EPISODE, terminal=False, undiscounted=True, estimator="average-reward"),
    "linear-random": Method(RANDOM_EPISODE, terminal=True, undiscounted=True, embedding=_linear),
    "geometric-5": Method(RANDOM_EPISODE, terminal=True, undiscounted=True, embedding=lambda *_: Geometric(5)),
    "geometric-10": Method(RANDOM_EPISODE, terminal=True, undiscounted=True, embedding=lambda *_: Geometric(10)),
    "geometric-film": Method(
        RANDOM_EPISODE, terminal=True, undiscounted=True, embedding=_geometric, conditioning="film"
    ),
}


def find_method(name: str) -> Method:
    """Return a row of METHODS.

    Raises:
        ConfigError: If there is no such method.
    """
    if name not in METHODS:
        near = difflib.get_close_matches(name, METHODS, n=1)
        hint = f" (did you mean {near[0]!r}?)" if near else ""
        raise ConfigError(f"unknown method {name!r}{hint}; the methods are {', '.join(METHODS)}")
    return METHODS[name]


def method_config(method: str, task: str, observation_size: int, preset: str = ZOO) -> PPOConfig:
    """Return the full configuration of a method on a task.

    Args:
        method: A key of METHODS.
        task: The task's name, as in `perdure list tasks`.
        observation_size: Length of its observations; phi's size follows from it.
        preset: A key of `perdure.ppo.presets.PRESETS`: the set of hyperparameters.

    Raises:
        ConfigError: If there is no such method or preset.
    """
    chosen, tuned = find_method(method), find_preset(task, preset)
    gamma = 1.0 if chosen.undiscounted else tuned.gamma
    protocol = HorizonProtocol(
        embedding=None if chosen.embedding is None else chosen.embedding(observation_size, task),
        horizon=chosen.horizon,
        end="terminated" if chosen.terminal else "truncated",
        gamma=gamma,
        normalizer_gamma=tuned.gamma,
    )
    config = PPOConfig(
        protocol=protocol, estimator=chosen.estimator, conditioning=chosen.conditioning, **tuned.settings
    )
    return config if chosen.n_envs is None else dataclasses.replace(config, n_envs=chosen.n_envs)


def default_clock(config: PPOConfig) -> Clock | None:
    """Return the clock of a policy of this configuration: Constant(min(500, half its longest training horizon)).

    Half, so that C is far from the end that the policy saw in training. None without an embedding.
    """
    if config.protocol.embedding is None:
        return None
    return Constant(min(DEPLOYED_STEPS_TO_GO, config.protocol.horizon.longest / 2))
