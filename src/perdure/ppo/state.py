"""State of a training run between two segments: what a resumed run needs, and no more."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING

import jax
import numpy as np
from numpy.typing import NDArray

from perdure.ppo.estimators import State, make_estimator
from perdure.ppo.networks import Params, init_params
from perdure.ppo.normalizer import start_moments
from perdure.ppo.rollout import Statistics
from perdure.ppo.update import AdamState, start_adam

if TYPE_CHECKING:
    from perdure.envs.world import TaskSpec
    from perdure.ppo.config import PPOConfig

EPISODE_COLUMNS = ("step", "return", "length")
ITERATION_COLUMNS = (
    "step",
    "policy_loss",
    "value_loss",
    "approx_kl",
    "clip_fraction",
    "explained_variance",
    "std",
)


@dataclass(frozen=True)
class SeedState:
    """One seed's run after ``segment`` segments."""

    seed: int
    segment: int
    """Segments finished."""
    params: Params
    adam: AdamState
    statistics: Statistics
    estimator: State
    """What the advantage estimator remembers."""
    episodes: NDArray[np.float64]
    """One row for each training episode that ended: EPISODE_COLUMNS, shape (episodes, 3)."""
    iterations: NDArray[np.float64]
    """One row for each iteration: ITERATION_COLUMNS, shape (iterations, 7)."""

    def extended(self, episodes: NDArray[np.float64], iterations: NDArray[np.float64]) -> SeedState:
        """Return the same run with more rows in its curves."""
        return dataclasses.replace(
            self,
            episodes=np.concatenate([self.episodes, episodes]),
            iterations=np.concatenate([self.iterations, iterations]),
        )


def start_state(seed: int, spec: TaskSpec, config: PPOConfig) -> SeedState:
    """Return the initial state of a run. The same seed gives the same initial weights."""
    embedded = config.protocol.embedding_size
    normalized = spec.observation_size + (embedded if config.protocol.normalize_embedding else 0)
    with jax.enable_x64(True):
        params = init_params(stream(seed, 0), spec.observation_size + embedded, len(spec.action_low), config)
        return SeedState(
            seed=seed,
            segment=0,
            params=params,
            adam=start_adam(params),
            statistics=Statistics(start_moments(normalized), start_moments(1)),
            estimator=make_estimator(config).start(),
            episodes=np.zeros((0, len(EPISODE_COLUMNS))),
            iterations=np.zeros((0, len(ITERATION_COLUMNS))),
        )


def stream(seed: int, *path: int) -> jax.Array:
    """Return a random key of the seed and a path of numbers, so that no generator state is stored."""
    key = jax.random.key(seed)
    for number in path:
        key = jax.random.fold_in(key, number)
    return key


def env_seeds(seed: int, segment: int, n_envs: int) -> list[int]:
    """Return seeds of the environments of one seed in one segment: 31-bit numbers that share no simple pattern."""
    return [int(s) for s in np.random.SeedSequence([seed, segment]).generate_state(n_envs, np.uint32) >> 1]
