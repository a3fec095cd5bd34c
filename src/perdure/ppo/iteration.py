"""One iteration of PPO: collect a rollout, estimate advantages, train several epochs of minibatches."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from perdure.ppo.estimators import State, Transitions, make_estimator
from perdure.ppo.networks import Params, forward, log_prob
from perdure.ppo.rollout import Draws, Episodes, Experience, draw, finish
from perdure.ppo.state import ITERATION_COLUMNS, SeedState, stream
from perdure.ppo.update import LOSSES, Batch, epoch
from perdure.runs import RunError

if TYPE_CHECKING:
    from perdure.envs.traced import Handle
    from perdure.ppo.config import PPOConfig
    from perdure.ppo.rollout import EnvState

T = TypeVar("T")

COMPILER_OPTIONS = {"xla_cpu_multi_thread_eigen": False}
"""A matrix product split over threads sums in another order: results would depend on the number of cores."""

ROLLOUT_STREAM, EPOCH_STREAM = 2, 3
"""First numbers of two random streams of a seed; 0 draws the first weights, 1 the first horizons."""


class Iteration:
    """The compiled programs of one iteration, for one configuration."""

    def __init__(self, config: PPOConfig, action_size: int) -> None:
        """Keep the configuration; compilation happens at first use."""
        self._config = config

        def compiled(function: Callable[..., Any], **options: Any) -> Callable[..., Any]:
            return jax.jit(partial(function, config=config), compiler_options=COMPILER_OPTIONS, **options)

        self._draw = compiled(partial(_draw, action_size=action_size))
        self._finish = compiled(finish)
        self._prepare = compiled(prepare)
        self._epoch = compiled(epoch, donate_argnums=(0, 1))

    def run(
        self, collect: Callable[..., Any], handle: Handle, env_state: EnvState, state: SeedState, iteration: int
    ) -> tuple[Handle, EnvState, SeedState]:
        """Train a seed for one iteration.

        Args:
            collect: The compiled loop over the environments, see `rollout.make_collect`.
            handle: The simulators.
            env_state: State of the environments.
            state: The seed's run so far; the memory of its weights is reused.
            iteration: Number of this iteration, from 0.

        Returns:
            Simulators, environments and run after it.
        """
        with jax.enable_x64(True):  # EnvPool's functions need 64 bits; learning does not
            draws = self._draw(state.seed, iteration)
            handle, last, trace = collect(handle, (env_state, state.statistics), state.params, draws)
            rollout = _ready(self._finish(last, trace))
        prepared = _ready(self._prepare(state.params, state.estimator, rollout.experience, state.seed, iteration))
        params, adam, losses = state.params, state.adam, []
        for order in prepared.orders:
            params, adam, reported = _ready(self._epoch(params, adam, prepared.batch, order))
            losses.append(reported)
        state = dataclasses.replace(
            state, params=params, adam=adam, statistics=rollout.statistics, estimator=prepared.estimator
        )
        episodes = _ended_episodes(rollout.episodes, iteration, self._config)
        row = _curve_row(params, losses, prepared, (iteration + 1) * self._config.rollout_size)
        if not np.isfinite([row[0, ITERATION_COLUMNS.index(name)] for name in LOSSES]).all():
            raise RunError(
                f"training diverged in iteration {iteration + 1}: losses are not finite (learning rate "
                f"{self._config.learning_rate:g})"
            )
        return handle, rollout.env_state, state.extended(episodes, row)


class Prepared(NamedTuple):
    """A rollout ready to be learned from."""

    batch: Batch
    orders: tuple[jax.Array, ...]
    """One permutation of the transitions for each epoch, (n,)."""
    explained_variance: jax.Array
    """1 - Var(targets - values) / Var(targets) before the update."""
    estimator: State
    """State of the advantage estimator after this rollout."""


def prepare(
    params: Params, estimator: State, experience: Experience, seed: Any, iteration: Any, *, config: PPOConfig
) -> Prepared:
    """Return values, advantages, targets and log probabilities of a whole rollout at once.

    The weights did not change while the rollout was collected, so nothing but actions had to be computed then.
    """
    n = config.rollout_size

    def values_of(inputs: jax.Array) -> jax.Array:
        flat = inputs.reshape(-1, inputs.shape[-1])
        return forward(params, "value", flat, config.activation)[:, 0].reshape(inputs.shape[:-1])

    values = values_of(experience.inputs)
    transitions = Transitions(
        experience.rewards, values, values_of(experience.last_inputs), experience.ends, experience.return_std
    )
    estimator, (advantages, targets) = make_estimator(config).estimate(estimator, transitions)
    inputs = experience.inputs[:-1].reshape(n, -1)
    actions = experience.actions.reshape(n, -1)
    mean = forward(params, "policy", inputs, config.activation)
    batch = Batch(
        inputs, actions, log_prob(mean, params["log_std"], actions), advantages.reshape(n), targets.reshape(n)
    )
    key = stream(seed, EPOCH_STREAM, iteration)
    orders = tuple(jax.random.permutation(jax.random.fold_in(key, i), n) for i in range(config.n_epochs))
    unexplained = jnp.var(targets - values[:-1]) / jnp.maximum(jnp.var(targets), 1e-12)
    return Prepared(batch, orders, 1.0 - unexplained, estimator)


def _draw(seed: Any, iteration: Any, *, action_size: int, config: PPOConfig) -> Draws:
    return draw(stream(seed, ROLLOUT_STREAM, iteration), action_size, config=config)


def _ready(result: T) -> T:
    """Wait for the result: JAX runs asynchronously and would keep the inputs in memory."""
    jax.block_until_ready(result)  # type: ignore[no-untyped-call]
    return result


def _ended_episodes(episodes: Episodes, iteration: int, config: PPOConfig) -> NDArray[np.float64]:
    """Return rows (step, return, length) of the episodes that ended, in the order of their steps."""
    when, lane = np.nonzero(np.asarray(episodes.done))
    steps = iteration * config.rollout_size + (when + 1) * config.n_envs
    returns, lengths = np.asarray(episodes.returns)[when, lane], np.asarray(episodes.lengths)[when, lane]
    return np.stack([steps, returns, lengths], axis=1).astype(np.float64)


def _curve_row(
    params: dict[str, jax.Array], losses: list[jax.Array], prepared: Prepared, step: int
) -> NDArray[np.float64]:
    means = np.mean([np.asarray(each, np.float64) for each in losses], axis=0)
    std = np.exp(np.asarray(params["log_std"], np.float64)).mean()
    return np.array([[step, *means, float(prepared.explained_variance), std]])
