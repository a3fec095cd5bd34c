"""Build worlds from a name, a factory or a VectorEnv."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from perdure.envs.gymnasium import NEVER, RUNNING, GymnasiumWorld, call, lift, refuse_running, title_of
from perdure.envs.suites import make_world, task_of_environment
from perdure.envs.vector_env import VectorEnvWorld
from perdure.envs.world import World
from perdure.errors import PerdureError

MOST_LANES = 48
"""Lanes of a world where their number is free."""
VALID_ENVS = (
    "env must be a Gymnasium id, a task (`perdure list`), a factory (a function that returns a gymnasium.Env) or a "
    "gymnasium.vector.VectorEnv"
)


@contextmanager
def open_env(env: Any) -> Iterator[OpenEnv]:
    """Open an environment for the duration of a block, with its own step limits lifted.

    Args:
        env: A name as `task_of_environment` reads it ("Hopper-v5", "envpool:Hopper-v5"); a factory, called once for
            each lane; or a VectorEnv, whose lanes are used as they are. It is not closed, and gets its limit back.

    Raises:
        PerdureError: If it is none of these, cannot be built, or has a limit that cannot be lifted.
    """
    from gymnasium import Env
    from gymnasium.vector import VectorEnv

    if isinstance(env, str):
        task = task_of_environment(env)
        yield OpenEnv(lambda seeds: make_world(task, seeds))
    elif any("envpool" in each.__module__ for each in type(env).__mro__):
        raise PerdureError(
            f"{VALID_ENVS}; an EnvPool cannot be seeded again: give its task's name, such as 'Hopper-v4'"
        )
    elif isinstance(env, VectorEnv):
        with _without_limits(env) as limit:
            title = title_of(getattr(env.unwrapped, "envs", [env])[0])
            yield OpenEnv(lambda seeds: _Borrowed(env, seeds, title, default_horizon=limit), int(env.num_envs))
    elif isinstance(env, Env):
        raise PerdureError(
            f"{VALID_ENVS}; this is a single environment, which can be in one episode at a time: give the function "
            "that builds it, such as lambda: gymnasium.make(...)"
        )
    elif callable(env):
        yield _factory(env)
    else:
        raise PerdureError(f"{VALID_ENVS}, not {type(env).__name__}")


@dataclass(frozen=True)
class OpenEnv:
    """Builds worlds of one environment."""

    make: Callable[[Sequence[int]], World]
    """Seeds, one per lane -> world."""
    lanes: int | None = None
    """Lanes that every world has, as a VectorEnv fixes them; None: one for each seed."""

    def groups(self, count: int) -> list[list[int]]:
        """Return numbers 0 to count - 1 in groups, one for each world; the last is repeated where lanes are fixed."""
        size = self.lanes or MOST_LANES
        groups = [list(range(first, min(first + size, count))) for first in range(0, count, size)]
        if self.lanes is not None:
            groups[-1] += [count - 1] * (self.lanes - len(groups[-1]))
        return groups


def _factory(factory: Callable[[], Any]) -> OpenEnv:
    from gymnasium import Env

    probe = call("env", "the factory", factory)
    if not isinstance(probe, Env):
        raise PerdureError(f"{VALID_ENVS}; this function returned {type(probe).__name__}")
    limit = min((steps for _, steps in lift(probe)), default=None)
    title = title_of(probe)
    probe.close()

    def build() -> Any:
        made = factory()
        if getattr(made, "unwrapped", None) is probe.unwrapped:
            raise PerdureError(f"{title}: the function returned the same environment again; it must build a new one")
        lift(made)
        return made

    return OpenEnv(lambda seeds: GymnasiumWorld([build] * len(seeds), seeds, title, default_horizon=limit))


class _Borrowed(VectorEnvWorld):
    """A world on a VectorEnv of the caller, which stays open when the world is closed."""

    def close(self) -> None:
        self.closed = True


# Step limits


@contextmanager
def _without_limits(vector: Any) -> Iterator[int | None]:
    """Lift the limits of a vector's environments for the duration of a block; yield the old limit, or None."""
    each = vector
    while each is not vector.unwrapped:
        refuse_running(each, getattr(each, RUNNING, False))
        each = each.env
    if not hasattr(vector.unwrapped, "envs"):
        yield from _without_remote_limit(vector)
        return
    found = []
    for env in vector.unwrapped.envs:
        found += lift(env)
    try:
        yield min((limit for _, limit in found), default=None)
    finally:
        for wrapper, limit in found:
            wrapper._max_episode_steps = limit


def _without_remote_limit(vector: Any) -> Iterator[int | None]:
    """Lift the limits of environments in other processes for the duration of a block; refuse other limits."""
    from gymnasium.vector import AsyncVectorEnv

    name = "_max_episode_steps"
    can_be_lifted = False
    if isinstance(vector.unwrapped, AsyncVectorEnv):
        ask = vector.unwrapped.call
        limit = None
        if ask("has_wrapper_attr", name)[0]:
            limit = vector.unwrapped.get_attr(name)[0]
        refuse_running(vector, ask("has_wrapper_attr", RUNNING)[0] and any(vector.unwrapped.get_attr(RUNNING)))
        can_be_lifted = ask("__str__")[0].count("<TimeLimit") < 2  # of several only the outermost can be
    else:
        limit = getattr(vector.spec, "max_episode_steps", None)
    if limit is None:
        yield None
        return
    if not can_be_lifted:
        raise PerdureError(
            f"{title_of(vector)}: this VectorEnv ends episodes after {limit} steps; build it with a max_episode_steps "
            "beyond the steps asked for, and give the limit as training_horizon"
        )
    vector.unwrapped.set_attr(name, NEVER)
    try:
        yield int(limit)
    finally:
        vector.unwrapped.set_attr(name, int(limit))
