"""One segment of training: fresh environments, a fixed number of iterations, several seeds side by side.

A run is a chain of segments. Each one builds its environments from (seed, segment) alone and cuts running episodes as
the end of a rollout does, because an engine's inner state and random generator cannot be saved. So a run that was
killed and a run that was not are the same run.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
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
    from perdure.envs.world import World
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
        self.task, self.config, self.threads = task, config, threads
        self._slot = WorldSlot()
        self._collect: Callable[..., Any] | None = None
        self._draw = jax.jit(partial(_draw, config=config), static_argnums=2, compiler_options=COMPILER_OPTIONS)
        self._finish = jax.jit(partial(finish, config=config), compiler_options=COMPILER_OPTIONS)
        self._prepare = jax.jit(partial(_prepare, config=config), compiler_options=COMPILER_OPTIONS)
        self._epoch = jax.jit(partial(epoch, config=config), compiler_options=COMPILER_OPTIONS, donate_argnums=(0, 1))

    def run(self, states: Sequence[SeedState], progress: Progress) -> list[SeedState]:
        """Carries seeds that stand at the same segment through that segment.

        Weights and optimiser state of ``states`` are used up: their memory becomes that of the states returned.
        """
        config, segment = self.config, states[0].segment
        first = segment * config.segment_iterations
        last = min(first + config.segment_iterations, config.iterations)
        seeds = [s for state in states for s in lane_seeds(state.seed, segment, config.n_envs)]
        world = make_world(self.task, seeds, threads=min(self.threads, len(seeds)))
        try:
            with ThreadPoolExecutor(self.threads) as workers:
                handle, states, lanes = self._start(world, states)
                for iteration in range(first, last):
                    handle, rollouts = self._roll_out(handle, states, lanes, iteration)
                    lanes = tuple(rollout.lanes for rollout in rollouts)
                    states = self._learn(states, rollouts, iteration, workers)
                    progress((iteration + 1) * config.rollout_size, _recent_return(states))
        finally:
            self._slot.clear()
            world.close()
        return [dataclasses.replace(state, segment=segment + 1) for state in states]

    def _start(self, world: World, states: Sequence[SeedState]) -> tuple[Handle, list[SeedState], tuple[Lanes, ...]]:
        n = self.config.n_envs
        observations = world.reset()
        started, lanes = [], []
        with jax.enable_x64(True):
            self._slot.fill(world)
            # EnvPool writes its pool's address into the program: one made for an earlier pool would step that one. So
            # this loop is compiled again for every segment, and everything else is kept out of it.
            collect = make_collect(trace(self._slot), world.spec, self.config)
            self._collect = jax.jit(collect, compiler_options=COMPILER_OPTIONS)
            for i, state in enumerate(states):
                uniform = jax.random.uniform(stream(state.seed, RESET_STREAM, state.segment), (n,), jnp.float64)
                lane = start_lanes(self.config, jnp.asarray(observations[i * n : (i + 1) * n]), uniform)
                moments = observe(self.config, state.statistics.observations, lane)
                started.append(dataclasses.replace(state, statistics=state.statistics._replace(observations=moments)))
                lanes.append(lane)
        return self._slot.handle, started, tuple(lanes)

    def _roll_out(
        self, handle: Handle, states: Sequence[SeedState], lanes: tuple[Lanes, ...], iteration: int
    ) -> tuple[Handle, tuple[SeedRollout, ...]]:
        assert self._collect is not None
        action_size = self._slot.world.spec.action_size
        with jax.enable_x64(True):  # EnvPool's functions need 64 bits; learning does not
            draws = tuple(self._draw(state.seed, iteration, action_size) for state in states)
            start = tuple((lane, state.statistics) for lane, state in zip(lanes, states, strict=True))
            handle, last, traces = self._collect(handle, start, tuple(state.params for state in states), draws)
            rollouts = tuple(self._finish(*each) for each in zip(last, traces, strict=True))
            return handle, _ready(rollouts)

    def _learn(
        self, states: Sequence[SeedState], rollouts: Sequence[SeedRollout], iteration: int, workers: ThreadPoolExecutor
    ) -> list[SeedState]:
        """Updates every seed. Work is handed out epoch by epoch, so that five seeds fill two cores evenly."""
        prepared: list[Prepared] = list(
            workers.map(
                lambda state, rollout: _ready(self._prepare(state.params, rollout.experience, state.seed, iteration)),
                states,
                rollouts,
            )
        )
        learned = [(state.params, state.adam) for state in states]
        losses: list[list[jax.Array]] = [[] for _ in states]

        def one_epoch(i: int, number: int) -> None:
            *weights, reported = self._epoch(*learned[i], prepared[i].batch, prepared[i].orders[number])
            learned[i] = _ready(tuple(weights))
            losses[i].append(reported)

        _interleave(workers, one_epoch, len(states), self.config.n_epochs)
        return [
            dataclasses.replace(
                state, params=learned[i][0], adam=learned[i][1], statistics=rollouts[i].statistics
            ).extended(
                _ended_episodes(rollouts[i].episodes, iteration, self.config),
                _iteration_row(learned[i][0], losses[i], prepared[i], (iteration + 1) * self.config.rollout_size),
            )
            for i, state in enumerate(states)
        ]


def _ready(result: T) -> T:
    """Waits for the result, so that work on other threads begins with nothing pending."""
    jax.block_until_ready(result)  # type: ignore[no-untyped-call]
    return result


def _draw(seed: Any, iteration: Any, action_size: int, *, config: PPOConfig) -> Draws:
    """Makes the key inside the program: one call instead of ten small ones."""
    return draw(stream(seed, ROLLOUT_STREAM, iteration), action_size, config=config)


def _prepare(params: Any, experience: Any, seed: Any, iteration: Any, *, config: PPOConfig) -> Prepared:
    return prepare(params, experience, stream(seed, EPOCH_STREAM, iteration), config=config)


def _interleave(workers: ThreadPoolExecutor, task: Callable[[int, int], None], chains: int, length: int) -> None:
    """Runs task(chain, 0), task(chain, 1), ... in order within each chain, the chains side by side."""
    if chains == 1:  # nothing to share: no thread to wake
        for number in range(length):
            task(0, number)
        return
    pending = {workers.submit(task, chain, 0): (chain, 0) for chain in range(chains)}
    while pending:
        future = next(iter(pending))
        chain, number = pending.pop(future)
        future.result()
        if number + 1 < length:
            pending[workers.submit(task, chain, number + 1)] = (chain, number + 1)


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


def _recent_return(states: Sequence[SeedState], episodes: int = 20) -> float:
    recent = [state.episodes[-episodes:, 1].mean() for state in states if len(state.episodes)]
    return float(np.mean(recent)) if recent else float("nan")
