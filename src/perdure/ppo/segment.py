"""One segment of training: fresh environments, a fixed number of iterations.

A run is a chain of segments. Each one builds its environments from (seed, segment) alone and cuts running episodes as
the end of a rollout does, because an engine's inner state and random generator cannot be saved. So a run that was
killed and a run that was not are the same run.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from perdure.envs import make_world
from perdure.envs.traced import Handle, WorldSlot, trace
from perdure.ppo.learner import Prepared, prepare
from perdure.ppo.rollout import (
    Draws,
    Episodes,
    Lanes,
    SeedRollout,
    draw,
    finish,
    make_collect,
    observe,
    start_lanes,
)
from perdure.ppo.state import SeedState, lane_seeds, stream
from perdure.ppo.update import epoch

if TYPE_CHECKING:
    from perdure.envs.world import TaskSpec, World
    from perdure.ppo.config import PPOConfig

T = TypeVar("T")

COMPILER_OPTIONS = {"xla_cpu_multi_thread_eigen": False}
"""A matrix product split over threads sums in another order: results would depend on the number of cores."""

RESET_STREAM, ROLLOUT_STREAM, EPOCH_STREAM = 1, 2, 3
"""First numbers of the random streams of a seed; 0 draws the start weights."""

Progress = Callable[[int, float], None]
"""Called after each iteration with (environment steps of one seed so far, mean return of the last episodes)."""


class SegmentRunner:
    """Compiled programs for one task and configuration, kept from segment to segment where that is possible."""

    def __init__(self, task: str, config: PPOConfig, threads: int) -> None:
        """Compiles nothing yet.

        Args:
            task: As `make_world` takes it.
            config: How it is learned.
            threads: Threads that step the environments; results do not depend on it.
        """
        self.task, self.config, self.threads = task, config, threads
        self._slot = WorldSlot()
        self._collect: Callable[..., Any] | None = None
        self._draw = jax.jit(partial(_draw, config=config), static_argnums=2, compiler_options=COMPILER_OPTIONS)
        self._finish = jax.jit(partial(finish, config=config), compiler_options=COMPILER_OPTIONS)
        self._prepare = jax.jit(partial(_prepare, config=config), compiler_options=COMPILER_OPTIONS)
        self._epoch = jax.jit(partial(epoch, config=config), compiler_options=COMPILER_OPTIONS, donate_argnums=(0, 1))

    @cached_property
    def spec(self) -> TaskSpec:
        """What the task is like."""
        world = make_world(self.task, [0])
        spec = world.spec
        world.close()
        return spec

    def run(self, state: SeedState, progress: Progress) -> SeedState:
        """Carries a seed through its next segment.

        Weights and optimiser state of ``state`` are used up: their memory becomes that of the state returned.
        """
        config = self.config
        first = state.segment * config.segment_iterations
        last = min(first + config.segment_iterations, config.iterations)
        seeds = lane_seeds(state.seed, state.segment, config.n_envs)
        world = make_world(self.task, seeds, threads=min(self.threads, len(seeds)))
        try:
            handle, state, lanes = self._start(world, state)
            for iteration in range(first, last):
                handle, rollout = self._roll_out(handle, state, lanes, iteration)
                lanes = rollout.lanes
                state = self._learn(state, rollout, iteration)
                progress((iteration + 1) * config.rollout_size, _recent_return(state))
        finally:
            self._slot.clear()
            world.close()
        return dataclasses.replace(state, segment=state.segment + 1)

    def _start(self, world: World, state: SeedState) -> tuple[Handle, SeedState, Lanes]:
        observations = world.reset()
        with jax.enable_x64(True):
            self._slot.fill(world)
            # EnvPool writes its pool's address into the program: one made for an earlier pool would step that one. So
            # this loop is compiled again for every segment, and everything else is kept out of it.
            collect = make_collect(trace(self._slot), world.spec, self.config)
            self._collect = jax.jit(collect, compiler_options=COMPILER_OPTIONS)
            key = stream(state.seed, RESET_STREAM, state.segment)
            lanes = start_lanes(
                self.config, jnp.asarray(observations), jax.random.uniform(key, (self.config.n_envs,), jnp.float64)
            )
            moments = observe(self.config, state.statistics.observations, lanes)
        started = dataclasses.replace(state, statistics=state.statistics._replace(observations=moments))
        return self._slot.handle, started, lanes

    def _roll_out(self, handle: Handle, state: SeedState, lanes: Lanes, iteration: int) -> tuple[Handle, SeedRollout]:
        assert self._collect is not None
        with jax.enable_x64(True):  # EnvPool's functions need 64 bits; learning does not
            draws = self._draw(state.seed, iteration, self._slot.world.spec.action_size)
            handle, last, traced = self._collect(handle, (lanes, state.statistics), state.params, draws)
            return handle, _ready(self._finish(last, traced))

    def _learn(self, state: SeedState, rollout: SeedRollout, iteration: int) -> SeedState:
        prepared: Prepared = _ready(self._prepare(state.params, rollout.experience, state.seed, iteration))
        params, adam, losses = state.params, state.adam, []
        for order in prepared.orders:
            params, adam, reported = _ready(self._epoch(params, adam, prepared.batch, order))
            losses.append(reported)
        return dataclasses.replace(state, params=params, adam=adam, statistics=rollout.statistics).extended(
            _ended_episodes(rollout.episodes, iteration, self.config),
            _iteration_row(params, losses, prepared, (iteration + 1) * self.config.rollout_size),
        )


def _ready(result: T) -> T:
    """Waits for the result: JAX would go on before it is there, and so would the memory it is made of."""
    jax.block_until_ready(result)  # type: ignore[no-untyped-call]
    return result


def _draw(seed: Any, iteration: Any, action_size: int, *, config: PPOConfig) -> Draws:
    """Makes the key inside the program: one call instead of ten small ones."""
    return draw(stream(seed, ROLLOUT_STREAM, iteration), action_size, config=config)


def _prepare(params: Any, experience: Any, seed: Any, iteration: Any, *, config: PPOConfig) -> Prepared:
    return prepare(params, experience, stream(seed, EPOCH_STREAM, iteration), config=config)


def _ended_episodes(episodes: Episodes, iteration: int, config: PPOConfig) -> NDArray[np.float64]:
    """Rows (step, return, length) of the episodes that ended, in the order of their steps."""
    when, lane = np.nonzero(np.asarray(episodes.done))
    steps = iteration * config.rollout_size + (when + 1) * config.n_envs
    returns, lengths = np.asarray(episodes.returns)[when, lane], np.asarray(episodes.lengths)[when, lane]
    return np.stack([steps, returns, lengths], axis=1).astype(np.float64)


def _iteration_row(
    params: dict[str, jax.Array], losses: list[jax.Array], ready: Prepared, step: int
) -> NDArray[np.float64]:
    means = np.mean([np.asarray(each, np.float64) for each in losses], axis=0)
    std = np.exp(np.asarray(params["log_std"], np.float64)).mean()
    return np.array([[step, *means, float(ready.explained_variance), std]])


def _recent_return(state: SeedState, episodes: int = 20) -> float:
    return float(state.episodes[-episodes:, 1].mean()) if len(state.episodes) else float("nan")
