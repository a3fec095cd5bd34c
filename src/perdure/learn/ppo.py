"""PPO as an algorithm (see `perdure.learn.algorithm`): `init`, `start`, `iterate` and `policy` over a tree of arrays.

`PPO.iterate` is one iteration from top to bottom: collect a rollout (`rollout.py`), prepare it (values, advantages and
targets), then train several epochs of minibatches (`epoch`, `loss`, `adam_step`).

Schulman et al., Proximal policy optimization algorithms (2017), eq. 7 and 9, with the details of Stable-Baselines3:
advantages normalized in each minibatch (unbiased standard deviation), squared value error without clipping, Adam with
epsilon 1e-5 (Kingma and Ba, 2015).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from perdure.envs.traced import Handle, WorldSlot, traced_world
from perdure.errors import PerdureError
from perdure.learn.advantages import EstimatorState, Transitions, make_estimator
from perdure.learn.algorithm import Metrics, Sent
from perdure.learn.first_rollout import first_rollout_facts
from perdure.learn.networks import EPSILON, Params, actor_inputs, entropy, forward, init_params, log_prob, start_moments
from perdure.learn.presets import default_clock
from perdure.learn.rollout import (
    EnvState,
    Episodes,
    Experience,
    Statistics,
    draw,
    finish,
    make_collect,
    start_env_state,
    update_moments,
)
from perdure.learn.start import continue_from
from perdure.policy import Normalizer, Policy, TaskInfo

if TYPE_CHECKING:
    from perdure.envs import TaskSpec
    from perdure.learn.config import PPOConfig

T = TypeVar("T")

ADAM_BETA1 = 0.9
ADAM_BETA2 = 0.999
ADAM_EPSILON = 1e-5
CLIP_NORM_EPSILON = 1e-6
COMPILER_OPTIONS = {"xla_cpu_multi_thread_eigen": False}
"""A matrix product split over threads sums in another order: results would depend on the number of cores."""
WEIGHT_STREAM, HORIZON_STREAM, ROLLOUT_STREAM, EPOCH_STREAM = range(4)
"""First numbers of the random streams of a seed: first weights, first horizons of a segment, rollouts, epochs."""
LOSSES = ("policy_loss", "value_loss", "approx_kl", "clip_fraction")
"""What a minibatch reports, in the order of the vector that carries it."""


class PPOState(NamedTuple):
    """What one seed has learned: a tree of arrays."""

    params: Params
    adam: AdamState
    statistics: Statistics
    estimator: EstimatorState
    """What the advantage estimator remembers."""


class AdamState(NamedTuple):
    """First and second moments of the gradient, and the number of updates so far."""

    first: Params
    second: Params
    count: jax.Array  # type: ignore[assignment]  # hides tuple.count, which nobody needs here


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Running:
    """The environments of one segment in the middle of their episodes: a tree of the arrays of `env_state`."""

    collect: Callable[..., Any] = field(metadata={"static": True})
    """Compiled loop over the environments, see `rollout.make_collect`."""
    handle: Handle = field(metadata={"static": True})
    env_state: EnvState


class PPO:
    """Proximal policy optimization for one configuration and task of continuous actions; keeps compiled programs."""

    diagnostics = (*LOSSES, "explained_variance", "std")
    """Names of `Metrics.diagnostics`, in their order."""

    def __init__(self, config: PPOConfig, spec: TaskSpec) -> None:
        if spec.discrete_actions:
            raise PerdureError(f"{spec.name}: PPO here needs continuous actions (a Box); this task's are discrete")
        self._config = config
        self._spec = spec

        def compiled(function: Callable[..., Any], **options: Any) -> Callable[..., Any]:
            return jax.jit(partial(function, config=config), compiler_options=COMPILER_OPTIONS, **options)

        self._draw = compiled(
            lambda seed, iteration, config: draw(stream(seed, ROLLOUT_STREAM, iteration), spec.action_size, config)
        )
        self._finish = compiled(finish)
        self._prepare = compiled(prepare)
        self._epoch = compiled(epoch, donate_argnums=(0, 1))

    def init(self, seed: int, start: Policy | None = None) -> PPOState:
        """Return the state before training. The same seed gives the same weights.

        Args:
            seed: The training seed.
            start: Training continues this policy, see `perdure.learn.start`; None: new weights.
        """
        config = self._config
        spec = self._spec
        embedded = config.protocol.embedding_size
        normalized = spec.observation_size
        if config.protocol.normalize_embedding:
            normalized += embedded
        with jax.enable_x64(True):
            key = stream(seed, WEIGHT_STREAM)
            params = init_params(key, spec.observation_size + embedded, spec.action_size, config)
            statistics = Statistics(start_moments(normalized), start_moments(1))
            if start is not None:
                params, seen = continue_from(start, params, config, spec)
                statistics = statistics._replace(observations=seen)
            return PPOState(params, start_adam(params), statistics, make_estimator(config).start())

    def start(
        self, state: PPOState, slot: WorldSlot, observations: Any, *, seed: int, segment: int
    ) -> tuple[PPOState, Running]:
        """Begin a segment; see `Algorithm.start`. The horizons of its first episodes depend on (seed, segment)."""
        config = self._config
        with jax.enable_x64(True):
            # EnvPool writes its pool's address into the program: one made for an earlier pool would step that one. So
            # this loop is compiled again for every segment, and everything else is kept out of it.
            collect = jax.jit(make_collect(traced_world(slot), self._spec, config), compiler_options=COMPILER_OPTIONS)
            key = stream(seed, HORIZON_STREAM, segment)
            uniform = jax.random.uniform(key, (config.n_envs,), jnp.float64)
            env_state = start_env_state(config, jnp.asarray(observations), uniform)
            moments = update_moments(config, state.statistics.observations, env_state)
        statistics = state.statistics._replace(observations=moments)
        return state._replace(statistics=statistics), Running(collect, slot.handle, env_state)

    def iterate(
        self, state: PPOState, running: Running, *, seed: int, iteration: int
    ) -> tuple[PPOState, Running, Metrics]:
        """Collect one rollout and learn from it.

        The memory of the weights and of the optimizer state is reused: ``state`` must not be used afterwards.

        Raises:
            PerdureError: A loss is not finite.
        """
        with jax.enable_x64(True):  # EnvPool's functions need 64 bits; learning does not
            draws = self._draw(seed, iteration)
            start = running.env_state, state.statistics
            handle, last, traced = running.collect(running.handle, start, state.params, draws)
            rollout = _ready(self._finish(last, traced))
        prepared = _ready(self._prepare(state.params, state.estimator, rollout.experience, seed, iteration))
        params = state.params
        adam = state.adam
        losses = []
        for order in prepared.orders:
            params, adam, reported = _ready(self._epoch(params, adam, prepared.batch, order))
            losses.append(reported)
        diagnostics = _diagnostics(params, losses, prepared)
        if not all(math.isfinite(diagnostics[name]) for name in LOSSES):
            raise PerdureError(
                f"training diverged in iteration {iteration + 1}: losses are not finite (learning rate "
                f"{self._config.learning_rate:g})"
            )
        learned = PPOState(params, adam, rollout.statistics, prepared.estimator)
        facts = {}
        if iteration == 0:
            facts = first_rollout_facts(rollout.episodes, rollout.experience.ends)
        sent = Sent(
            np.asarray(rollout.experience.actions),
            np.asarray(rollout.episodes.done),
            np.asarray(rollout.env_state.observations),
        )
        metrics = Metrics(_ended_episodes(rollout.episodes, iteration, self._config), diagnostics, facts, sent)
        return learned, Running(running.collect, handle, rollout.env_state), metrics

    def observation_std(self, state: PPOState) -> NDArray[np.float64]:
        """Return the spread that the running normalizer divides by; see `Algorithm.observation_std`."""
        variance = np.asarray(state.statistics.observations.var, np.float64)
        return np.asarray(np.sqrt(variance[: self._spec.observation_size]))

    def policy(self, state: PPOState) -> Policy:
        """Return the policy of the current weights, without provenance and reference."""
        spec = self._spec
        moments = state.statistics.observations
        return Policy(
            task=TaskInfo.of(spec),
            weights={name: np.asarray(value) for name, value in state.params.items()},
            activation=self._config.activation,
            normalizer=Normalizer(np.asarray(moments.mean), np.asarray(moments.var), self._config.clip_obs, EPSILON),
            protocol=self._config.protocol,
            clock=default_clock(self._config),
            return_scale=math.sqrt(float(state.statistics.returns.var[0]) + EPSILON),
        )


class Batch(NamedTuple):
    """Transitions to learn from; the leading axis is n."""

    inputs: jax.Array
    """What the networks saw: normalized observation and phi, (n, input_size)."""
    actions: jax.Array
    """As sampled, before clipping to the action box, (n, action_size)."""
    log_probs: jax.Array
    """Under the policy that acted, (n,)."""
    advantages: jax.Array
    """(n,)."""
    returns: jax.Array
    """Targets of the value network, (n,)."""


class Prepared(NamedTuple):
    """A rollout ready to be learned from."""

    batch: Batch
    orders: tuple[jax.Array, ...]
    """One permutation of the transitions for each epoch, (n,)."""
    explained_variance: jax.Array
    """1 - Var(targets - values) / Var(targets) before the update."""
    estimator: EstimatorState
    """State of the advantage estimator after this rollout."""


def prepare(
    params: Params, estimator: EstimatorState, experience: Experience, seed: Any, iteration: Any, *, config: PPOConfig
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


def epoch(
    params: Params, adam: AdamState, batch: Batch, order: jax.Array, config: PPOConfig
) -> tuple[Params, AdamState, jax.Array]:
    """Make one pass over a rollout.

    Args:
        params: Weights before.
        adam: Optimizer state before.
        batch: The whole rollout, n transitions.
        order: A permutation of range(n), shape (n,): consecutive slices of it are the minibatches.
        config: The learner's settings.

    Returns:
        Weights and optimizer state after, and the mean LOSSES of the minibatches, (4,).
    """

    def minibatch(carry: tuple[Params, AdamState], indices: jax.Array) -> tuple[tuple[Params, AdamState], jax.Array]:
        params, adam = carry
        picked = jax.tree.map(lambda x: x[indices], batch)
        gradient, losses = jax.grad(loss, has_aux=True)(params, picked, config)
        return adam_step(params, adam, gradient, _step_size(config, adam.count), config.max_grad_norm), losses

    (params, adam), losses = jax.lax.scan(minibatch, (params, adam), order.reshape(-1, config.batch_size))
    if config.log_std_end is not None:
        params = {**params, "log_std": jnp.minimum(params["log_std"], _log_std_ceiling(config, adam.count))}
    return params, adam, losses.mean(axis=0)


def loss(params: Params, batch: Batch, config: PPOConfig) -> tuple[jax.Array, jax.Array]:
    """Return the loss of one minibatch (surrogate, entropy bonus, squared value error), and LOSSES, shape (4,)."""
    advantages = batch.advantages
    if advantages.shape[0] > 1:
        advantages = (advantages - advantages.mean()) / (advantages.std(ddof=1) + 1e-8)
    mean = forward(params, "policy", actor_inputs(batch.inputs, config), config.activation)
    values = forward(params, "value", batch.inputs, config.activation)[:, 0]
    log_ratio = log_prob(mean, params["log_std"], batch.actions) - batch.log_probs
    ratio = jnp.exp(log_ratio)
    clipped = jnp.clip(ratio, 1 - config.clip_range, 1 + config.clip_range)
    policy_loss = -jnp.minimum(advantages * ratio, advantages * clipped).mean()
    value_loss = jnp.square(batch.returns - values).mean()
    total = policy_loss - config.ent_coef * entropy(params["log_std"]) + config.vf_coef * value_loss
    clip_fraction = (jnp.abs(ratio - 1) > config.clip_range).astype(jnp.float32).mean()
    return total, jnp.stack([policy_loss, value_loss, (ratio - 1 - log_ratio).mean(), clip_fraction])


def start_adam(params: Params) -> AdamState:
    """Return zero moments."""
    first, second = (jax.tree.map(jnp.zeros_like, params) for _ in range(2))  # two buffers: both are donated
    return AdamState(first, second, jnp.zeros((), jnp.int32))


def adam_step(
    params: Params, state: AdamState, gradient: Params, learning_rate: jax.Array | float, max_grad_norm: float
) -> tuple[Params, AdamState]:
    """Make one Adam step along the gradient cut to ``max_grad_norm``.

    The bias corrections are folded into the step size and epsilon (Kingma and Ba, section 2, last paragraph), which
    leaves one division and one square root for each weight.
    """
    norm = jnp.sqrt(sum((jnp.vdot(g, g) for g in jax.tree.leaves(gradient)), start=jnp.zeros(())))
    scale = jnp.minimum(1.0, max_grad_norm / (norm + CLIP_NORM_EPSILON))
    count = state.count + 1
    steps = count.astype(jnp.float32)
    correction = jnp.sqrt(1 - ADAM_BETA2**steps)
    step_size = learning_rate * correction / (1 - ADAM_BETA1**steps)
    epsilon = ADAM_EPSILON * correction
    first_weight = (1 - ADAM_BETA1) * scale
    second_weight = (1 - ADAM_BETA2) * jnp.square(scale)
    first = jax.tree.map(lambda m, g: ADAM_BETA1 * m + first_weight * g, state.first, gradient)
    second = jax.tree.map(lambda v, g: ADAM_BETA2 * v + second_weight * (g * g), state.second, gradient)
    params = jax.tree.map(lambda p, m, v: p - step_size * m / (jnp.sqrt(v) + epsilon), params, first, second)
    return params, AdamState(first, second, count)


def _step_size(config: PPOConfig, count: jax.Array) -> jax.Array | float:
    """Return Adam's step size after ``count`` steps."""
    if config.learning_rate_decay == "none":
        return config.learning_rate
    return config.learning_rate * (1 - (_iteration(config, count) + 1) / config.iterations)


def _log_std_ceiling(config: PPOConfig, count: jax.Array) -> jax.Array:
    """Return the largest log standard deviation after ``count`` Adam steps."""
    assert config.log_std_end is not None
    begin, end = config.log_std_fall
    share = jnp.clip((_iteration(config, count) / config.iterations - begin) / (end - begin), 0.0, 1.0)
    return config.log_std_init + share * (config.log_std_end - config.log_std_init)


def _iteration(config: PPOConfig, count: jax.Array) -> jax.Array:
    return count // (config.n_epochs * (config.rollout_size // config.batch_size))


def stream(seed: Any, *path: Any) -> jax.Array:
    """Return a random key of the seed and a path of numbers, so that no generator state is stored."""
    key = jax.random.key(seed)
    for number in path:
        key = jax.random.fold_in(key, number)
    return key


def _ready(result: T) -> T:
    """Wait for the result: JAX runs asynchronously and would keep the inputs in memory."""
    jax.block_until_ready(result)  # type: ignore[no-untyped-call]
    return result


def _diagnostics(params: Params, losses: list[jax.Array], prepared: Prepared) -> dict[str, float]:
    """Return mean losses, explained variance and standard deviation of the actions."""
    means = np.mean([np.asarray(each, np.float64) for each in losses], axis=0)
    std = float(np.exp(np.asarray(params["log_std"], np.float64)).mean())
    return dict(zip(PPO.diagnostics, (*means.tolist(), float(prepared.explained_variance), std), strict=True))


def _ended_episodes(episodes: Episodes, iteration: int, config: PPOConfig) -> NDArray[np.float64]:
    """Return rows (step, return, length) of the episodes that ended, in the order of their steps."""
    when, env = np.nonzero(np.asarray(episodes.done))
    steps = iteration * config.rollout_size + (when + 1) * config.n_envs
    returns = np.asarray(episodes.returns)[when, env]
    lengths = np.asarray(episodes.lengths)[when, env]
    return np.stack([steps, returns, lengths], axis=1).astype(np.float64)
