"""`World` of single Gymnasium environments, one per lane."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module
from typing import Any

import numpy as np

from perdure.envs.checks import checked_actions, checked_seeds
from perdure.envs.divergence import divergence_count
from perdure.envs.errors import UnknownTask, WorldError
from perdure.envs.lane_tracker import LaneTracker, TrackedWorld
from perdure.envs.spaces import shaped_actions, spec_of
from perdure.envs.third_party import call, read_flag, read_observation, read_reward, read_tuple
from perdure.envs.world import FloatArray, IntArray, Step, TaskSpec


class GymnasiumWorld(TrackedWorld):
    """Lanes of one Gymnasium environment (see `World`), stepped one after the other in this thread.

    A lane's seed goes into its first `reset`; later resets continue the environment's own generator, as Gymnasium
    intends. Stepping some lanes steps only their environments.
    """

    def __init__(
        self,
        factories: Sequence[Callable[[], Any]],
        seeds: Sequence[int],
        name: str = "custom",
        suite: str = "Gymnasium",
        default_horizon: int | None = None,
    ) -> None:
        """Build the environments.

        A factory should not wrap its environment in Gymnasium's TimeLimit: lanes have no horizon. If it does, the
        limit is reported as `truncated`.

        Args:
            factories: One per lane, each returns a new environment of the same task.
            seeds: One per lane, see `checked_seeds`.
            name: Goes into the spec.
            suite: Goes into the spec.
            default_horizon: Goes into the spec; None means the first environment's own limit.

        Raises:
            WorldError: If seeds and factories do not match or the spaces do not fit the contract.
        """
        seeds = checked_seeds(seeds)
        if len(factories) != len(seeds):
            raise WorldError(f"{name}: {len(factories)} environments need as many seeds, got {len(seeds)}.")
        self._next_seeds: list[int | None] = list(seeds)
        self._tracker = LaneTracker(len(seeds))
        self._envs: list[Any] = []
        try:
            for factory in factories:
                self._envs.append(call(name, "making it", factory))
            self._spec = self._checked_spec(name, suite, default_horizon)
        except BaseException:
            for env in self._envs:
                with suppress(Exception):  # the first error is the one to show
                    env.close()
            raise

    def _checked_spec(self, name: str, suite: str, default_horizon: int | None) -> TaskSpec:
        """Return the spec of the environments if they are different objects with the same spaces."""
        if len({id(env.unwrapped) for env in self._envs}) < len(self._envs):
            raise WorldError(f"{name}: two lanes got the same environment; the function must build a new one each time")
        first = self._envs[0]
        limit = default_horizon if default_horizon is not None else getattr(first.spec, "max_episode_steps", None)
        self._space, self._action_space = first.observation_space, first.action_space
        spec = spec_of(name, suite, first, (self._space, self._action_space), limit)
        for env in self._envs[1:]:
            if env.observation_space != self._space or env.action_space != self._action_space:
                raise WorldError(f"{name}: every lane must have the same spaces, got {env} beside {first}.")
        return spec

    @classmethod
    def from_id(cls, env_id: str, seeds: Sequence[int]) -> GymnasiumWorld:
        """Build lanes of a registered environment, without the time limit it is registered with.

        Args:
            env_id: Gymnasium's id, e.g. "Pendulum-v1", or "module:Id-v0" to import a module first.
            seeds: One per lane.

        Returns:
            The world.

        Raises:
            UnknownTask: If Gymnasium has no such id.
            WorldError: If the environment cannot be built or does not fit the contract.
        """
        import gymnasium

        module, _, registered = env_id.rpartition(":")
        try:
            if module:
                _import(module, env_id)
            spec = gymnasium.spec(registered)
        except (gymnasium.error.Error, ImportError) as problem:
            if module and isinstance(problem, ImportError):
                absent = isinstance(problem, ModuleNotFoundError) and problem.name == module.partition(".")[0]
                hint = "; put its folder on PYTHONPATH, or install it" if absent else ""
                raise WorldError(f"gymnasium:{env_id} cannot be imported: {problem}{hint}") from problem
            known = [f"gymnasium:{known_id}" for known_id in gymnasium.registry]
            raise UnknownTask(f"gymnasium:{env_id}", known) from None

        def build() -> Any:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # about outdated versions
                return gymnasium.make(env_id, max_episode_steps=-1, disable_env_checker=True)

        factories = [build] * len(checked_seeds(seeds))
        return cls(factories, seeds, f"gymnasium:{env_id}", default_horizon=spec.max_episode_steps)

    def reset(self, lanes: IntArray | None = None) -> FloatArray:
        """See `World.reset`."""
        chosen = self._tracker.lanes_to_reset(lanes)
        observations = np.empty((len(chosen), self._spec.observation_size))
        for row, lane in enumerate(chosen):
            where, env = f"{self._spec.name}, lane {lane}", self._envs[lane]
            returned = call(where, "reset", env.reset, seed=self._next_seeds[lane])
            observation, _ = read_tuple(where, "reset", returned, 2)
            self._next_seeds[lane] = None
            observations[row] = read_observation(where, "reset", self._space, observation)
        self._tracker.begin(chosen)
        return observations

    def step(self, actions: FloatArray, lanes: IntArray | None = None) -> Step:
        """See `World.step`."""
        chosen = self._tracker.lanes_to_step(lanes)
        shaped = shaped_actions(self._action_space, checked_actions(actions, chosen, self._spec))
        observations = np.empty((len(chosen), self._spec.observation_size))
        rewards = np.empty(len(chosen))
        terminated, truncated, diverged = np.empty((3, len(chosen)), np.bool_)
        steps = self._tracker.elapsed
        for row, lane in enumerate(chosen):
            where = f"{self._spec.name}, lane {lane}, step {steps[lane] + 1}"
            returned = call(where, "step", self._envs[lane].step, shaped[row])
            observation, reward, ended, cut, _ = read_tuple(where, "step", returned, 5)
            observations[row] = read_observation(where, "step", self._space, observation)
            rewards[row] = read_reward(where, reward)
            terminated[row], truncated[row] = read_flag(where, "terminated", ended), read_flag(where, "truncated", cut)
            diverged[row] = divergence_count(self._envs[lane]) > 0
        elapsed = self._tracker.advance(chosen, terminated | truncated)
        return Step(observations, rewards, terminated, truncated, elapsed, diverged)

    def close(self) -> None:
        """See `World.close`."""
        if not self._tracker.closed:
            self._tracker.closed = True
            for env in self._envs:
                env.close()


def _import(module: str, env_id: str) -> None:
    """Import a module that the user named; convert every error except ImportError to WorldError."""
    try:
        call(f"gymnasium:{env_id}", f"importing {module}", import_module, module)
    except WorldError as error:
        if isinstance(error.__cause__, ImportError):
            raise error.__cause__ from None
        raise
