"""Run one segment of training: new environments, a fixed number of iterations.

A run is a chain of segments. Each one builds its environments from (seed, segment) alone and cuts running episodes as
the end of a rollout does, because an engine's inner state and random generator cannot be saved. So a run that was
killed and a run that was not are the same run.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp

from perdure.envs import make_world
from perdure.envs.traced import Handle, WorldSlot, trace
from perdure.ppo.errors import ConfigError
from perdure.ppo.iteration import COMPILER_OPTIONS, Iteration
from perdure.ppo.rollout import EnvState, make_collect, start_env_state, update_moments
from perdure.ppo.state import SeedState, env_seeds, stream

if TYPE_CHECKING:
    from perdure.envs.world import TaskSpec, World
    from perdure.ppo.config import PPOConfig

RESET_STREAM = 1
"""First number of the random stream that draws the first horizons of a segment."""

ProgressCallback = Callable[[int, float], None]
"""Called after each iteration with (environment steps of one seed so far, mean return of the last episodes)."""


class SegmentRunner:
    """Compiled programs for one task and configuration, kept from segment to segment where that is possible."""

    def __init__(self, task: str, config: PPOConfig, threads: int) -> None:
        """Keep the settings; compilation happens at first use.

        Args:
            task: As `make_world` takes it.
            config: How it is learned.
            threads: Threads that step the environments; results do not depend on it.
        """
        self.task, self.config, self.threads = task, config, threads
        self._slot = WorldSlot()

    @cached_property
    def spec(self) -> TaskSpec:
        """Description of the task; ConfigError for a task with discrete actions."""
        world = make_world(self.task, [0])
        spec = world.spec
        world.close()
        if spec.discrete_actions:
            raise ConfigError(f"{self.task}: PPO here needs continuous actions (a Box); this task's are discrete")
        return spec

    @cached_property
    def _iteration(self) -> Iteration:
        return Iteration(self.config, self.spec.action_size)

    def run(self, state: SeedState, progress: ProgressCallback) -> SeedState:
        """Train a seed for its next segment.

        Weights and optimizer state of ``state`` are used up: their memory becomes that of the state returned.
        """
        config = self.config
        first = state.segment * config.segment_iterations
        last = min(first + config.segment_iterations, config.iterations)
        seeds = env_seeds(state.seed, state.segment, config.n_envs)
        world = make_world(self.task, seeds, threads=min(self.threads, len(seeds)))
        try:
            collect, handle, env_state, state = self._start(world, state)
            for iteration in range(first, last):
                handle, env_state, state = self._iteration.run(collect, handle, env_state, state, iteration)
                progress((iteration + 1) * config.rollout_size, _recent_return(state))
        except Exception as error:
            if self._slot.error is None or error is self._slot.error:
                raise
            raise self._slot.error from None
        finally:
            self._slot.clear()
            world.close()
        return dataclasses.replace(state, segment=state.segment + 1)

    def _start(self, world: World, state: SeedState) -> tuple[Callable[..., Any], Handle, EnvState, SeedState]:
        observations = world.reset()
        with jax.enable_x64(True):
            self._slot.fill(world)
            # EnvPool writes its pool's address into the program: one made for an earlier pool would step that one. So
            # this loop is compiled again for every segment, and everything else is kept out of it.
            collect = make_collect(trace(self._slot), world.spec, self.config)
            compiled = jax.jit(collect, compiler_options=COMPILER_OPTIONS)
            key = stream(state.seed, RESET_STREAM, state.segment)
            env_state = start_env_state(
                self.config, jnp.asarray(observations), jax.random.uniform(key, (self.config.n_envs,), jnp.float64)
            )
            moments = update_moments(self.config, state.statistics.observations, env_state)
        started = dataclasses.replace(state, statistics=state.statistics._replace(observations=moments))
        return compiled, self._slot.handle, env_state, started


def _recent_return(state: SeedState, episodes: int = 20) -> float:
    return float(state.episodes[-episodes:, 1].mean()) if len(state.episodes) else float("nan")
