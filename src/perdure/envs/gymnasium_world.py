"""Single Gymnasium environments, one per lane, behind the vector contract."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

import numpy as np

from perdure.envs.blow_up import blow_ups
from perdure.envs.checks import checked_actions, checked_seeds
from perdure.envs.errors import UnknownTask, WorldError, nearest_names
from perdure.envs.lanes import Booked, LaneBook
from perdure.envs.spaces import flat_observation, shaped_actions, spec_of
from perdure.envs.world import FloatArray, IntArray, Step


class GymnasiumWorld(Booked):
    """Lanes of one Gymnasium environment (see `World`), stepped one after the other in this thread.

    A lane's seed goes into its first `reset`; later resets continue the environment's own generator, as Gymnasium
    intends. Stepping some lanes steps only their environments.
    """

    def __init__(
        self,
        factories: Sequence[Callable[[], Any]],
        seeds: Sequence[int],
        name: str = "custom",
        family: str = "Gymnasium",
        default_horizon: int | None = None,
    ) -> None:
        """Builds the environments.

        A factory should not wrap its environment in Gymnasium's TimeLimit: horizons are set by `reset`. If it does, the
        limit is reported as `truncated`.

        Args:
            factories: One per lane, each returns a new environment of the same task.
            seeds: One per lane, see `checked_seeds`.
            name: Goes into the spec.
            family: Goes into the spec.
            default_horizon: Goes into the spec; None takes the first environment's own limit.

        Raises:
            WorldError: If seeds and factories do not match or the spaces do not fit the contract.
        """
        seeds = checked_seeds(seeds)
        if len(factories) != len(seeds):
            raise WorldError(f"{name}: {len(factories)} environments need as many seeds, got {len(seeds)}.")
        self._envs = [factory() for factory in factories]
        self._next_seeds: list[int | None] = list(seeds)
        first = self._envs[0]
        limit = default_horizon if default_horizon is not None else getattr(first.spec, "max_episode_steps", None)
        self._space, self._action_space = first.observation_space, first.action_space
        self._spec = spec_of(name, family, first, (self._space, self._action_space), limit)
        for env in self._envs[1:]:
            if env.observation_space != self._space or env.action_space != self._action_space:
                raise WorldError(f"{name}: every lane must have the same spaces, got {env} beside {first}.")
        self._book = LaneBook(len(seeds))

    @classmethod
    def from_id(cls, env_id: str, seeds: Sequence[int]) -> GymnasiumWorld:
        """Builds lanes of a registered environment, without the time limit it is registered with.

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

        try:
            module, _, registered = env_id.rpartition(":")
            if module:
                import_module(module)
            spec = gymnasium.spec(registered)
        except (gymnasium.error.Error, ImportError) as problem:
            known = [f"gymnasium:{known_id}" for known_id in gymnasium.registry]
            if nearest_names(f"gymnasium:{env_id}", known) or not isinstance(problem, ImportError):
                raise UnknownTask(f"gymnasium:{env_id}", known) from None
            raise WorldError(f"gymnasium:{env_id} cannot be imported: {problem}") from problem

        def build() -> Any:
            try:
                return gymnasium.make(env_id, max_episode_steps=-1, disable_env_checker=True)
            except (gymnasium.error.Error, ImportError) as problem:
                raise WorldError(f"gymnasium:{env_id} cannot be built: {problem}") from problem

        factories = [build] * len(checked_seeds(seeds))
        return cls(factories, seeds, f"gymnasium:{env_id}", default_horizon=spec.max_episode_steps)

    def reset(self, lanes: IntArray | None = None, horizons: FloatArray | float = math.inf) -> FloatArray:
        """See `World.reset`."""
        chosen, checked = self._book.lanes_to_reset(lanes, horizons)
        observations = np.empty((len(chosen), self._spec.observation_size))
        for row, lane in enumerate(chosen):
            observation, _ = self._envs[lane].reset(seed=self._next_seeds[lane])
            self._next_seeds[lane] = None
            observations[row] = flat_observation(self._space, observation)
        self._book.begin(chosen, checked)
        return observations

    def step(self, actions: FloatArray, lanes: IntArray | None = None) -> Step:
        """See `World.step`."""
        chosen = self._book.lanes_to_step(lanes)
        shaped = shaped_actions(self._action_space, checked_actions(actions, chosen, self._spec))
        observations = np.empty((len(chosen), self._spec.observation_size))
        rewards = np.empty(len(chosen))
        terminated, truncated, diverged = np.empty((3, len(chosen)), np.bool_)
        for row, lane in enumerate(chosen):
            observation, rewards[row], terminated[row], truncated[row], _ = self._envs[lane].step(shaped[row])
            observations[row] = flat_observation(self._space, observation)
            diverged[row] = blow_ups(self._envs[lane]) > 0
        elapsed, horizon_end = self._book.advance(chosen, terminated | truncated)
        return Step(observations, rewards, terminated, truncated, horizon_end, elapsed, diverged)

    def close(self) -> None:
        """See `World.close`."""
        if not self._book.closed:
            self._book.closed = True
            for env in self._envs:
                env.close()
