"""Methods as data: what a method says about time, laid over a task's tuned hyperparameters.

| method | gamma | horizon T | at T | phi | what it is |
|---|---|---|---|---|---|
| ``ppo`` | tuned | 1000 | bootstrap last observation | - | Stable-Baselines3's PPO (>= 1.4) with rl-zoo's settings |
| ``ppo-undiscounted`` | 1 | 1000 | bootstrap last observation | - | the thesis' second baseline; see below |
| ``ppo-undiscounted-terminal`` | 1 | 1000 | terminal | - | the same with an anchor: V(., T) = 0 |
| ``ppo-short`` | tuned | 200 | bootstrap last observation | - | figure 3-1 of the thesis |
| ``linear`` | tuned | 1000 | terminal | Linear | Pardo et al., Time limits in reinforcement learning (2018) |
| ``linear-10-workers`` | tuned | 1000 | terminal | Linear | 10 environments, each for the preset's n_steps |
| ``geometric`` | 1 | U[200, 1000] | terminal | Geometric(d) | the thesis |
| ``random-horizon`` | 1 | U[200, 1000] | terminal | - | control: random T without phi |
| ``geometric-fixed`` | 1 | 1000 | terminal | Geometric(d) | control: phi without random T |
| ``ppo-average-reward`` | 1 | 1000 | bootstrap last observation | - | reward per step; a fall is a cost, not an end |
| ``linear-random`` | 1 | U[200, 1000] | terminal | Linear | control: linear phi with random T |

With gamma = 1 and a bootstrap at every limit nothing pins the value function down: V + c satisfies the same equations
for every c, so it may drift. Advantages only need differences of V, which is why the baseline can learn at all.

The reward normalizer's gamma is the task's tuned gamma in every method, also where gamma = 1. rl-zoo would copy
gamma = 1 into it; rewards are then divided by the spread of whole episodes' returns (about 700 for a reward of 3), far
from the scale the other settings were tuned at. HalfCheetah-v3, geometric, seed 0, training return after 165,000 steps:
219 with 0.98, and still below -100 with 1 after 330,000. ``--ppo.protocol.normalizer-gamma 1`` brings the other back.

Evaluation acts with the mean of the Gaussian and
uses the final weights; the thesis says neither.
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
from perdure.ppo.config import PPOConfig
from perdure.ppo.errors import ConfigError
from perdure.ppo.presets import ZOO, find_preset

EPISODE = Fixed(1000)
SHORT_EPISODE = Fixed(200)
RANDOM_EPISODE = Uniform(200, 1000)
DEPLOYED_STEPS_TO_GO = 500
"""Largest C of the default clock."""


@dataclass(frozen=True)
class Method:
    """What one row of the table says. ``embedding`` makes phi from (observation size, task)."""

    horizon: HorizonDistribution
    terminal: bool
    undiscounted: bool = False
    embedding: Callable[[int, str], Embedding] | None = None
    n_envs: int | None = None
    estimator: str = "discounted"


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
}


def method_config(method: str, task: str, observation_size: int, preset: str = ZOO) -> PPOConfig:
    """Return the full configuration of a method on a task.

    Args:
        method: A key of METHODS.
        task: The task's name, as worlds are named.
        observation_size: Length of its observations; phi's size follows from it.
        preset: A key of `perdure.ppo.presets.PRESETS`: whose hyperparameters.

    Raises:
        ConfigError: If there is no such method or preset.
    """
    if method not in METHODS:
        near = difflib.get_close_matches(method, METHODS, n=1)
        hint = f" (did you mean {near[0]!r}?)" if near else ""
        raise ConfigError(f"unknown method {method!r}{hint}; the methods are {', '.join(METHODS)}")
    chosen, tuned = METHODS[method], find_preset(task, preset)
    gamma = 1.0 if chosen.undiscounted else tuned.gamma
    protocol = HorizonProtocol(
        embedding=None if chosen.embedding is None else chosen.embedding(observation_size, task),
        horizon=chosen.horizon,
        end="terminated" if chosen.terminal else "truncated",
        gamma=gamma,
        normalizer_gamma=tuned.gamma,
    )
    config = PPOConfig(protocol=protocol, estimator=chosen.estimator, **tuned.settings)
    return config if chosen.n_envs is None else dataclasses.replace(config, n_envs=chosen.n_envs)


def default_clock(config: PPOConfig) -> Clock | None:
    """Return the clock of a policy of this configuration: Constant(min(500, half its longest training horizon)).

    Half, so that C is far from the end that the policy saw in training. None without an embedding.
    """
    if config.protocol.embedding is None:
        return None
    return Constant(min(DEPLOYED_STEPS_TO_GO, config.protocol.horizon.longest / 2))
