"""Helpers of the single and the vector limit."""

from __future__ import annotations

import math
from typing import Any

import gymnasium
import numpy as np
from gymnasium.wrappers import TimeLimit

from perdure.horizon.distribution import HorizonDistribution
from perdure.horizon.errors import HorizonError
from perdure.horizon.protocol import check_end

HORIZON_STREAM = 1
"""Spawn key of the horizons' random numbers: seeded like the environment, but a separate stream. From the same
stream, long episodes would go with certain start states."""


def horizon_generator(seed: int | None) -> np.random.Generator:
    """Return the generator that draws the horizons of one environment.

    Args:
        seed: The environment's seed; None takes fresh entropy.
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(HORIZON_STREAM,)))


def draw_horizon(distribution: HorizonDistribution, generator: np.random.Generator) -> float:
    """Return T of the next episode, in steps.

    Args:
        distribution: Distribution of T.
        generator: From :func:`horizon_generator`.
    """
    return float(distribution.from_uniform(generator.random()))


def check_limit(env: Any, distribution: HorizonDistribution, end: Any) -> None:
    """Refuse an invalid limit.

    Args:
        env: Environment or vector environment to be limited.
        distribution: Distribution of T.
        end: What reaching T means.

    Raises:
        HorizonError: If distribution or end are invalid, or the environment would cut episodes before the longest T.
    """
    if not isinstance(distribution, HorizonDistribution):
        raise HorizonError(
            f"a horizon limit needs a HorizonDistribution, such as Uniform(200, 1000), got {distribution!r}"
        )
    check_end(end)
    own = own_limit(env)
    if own < distribution.longest:
        raise HorizonError(
            f"the environment cuts its episodes after {own:g} steps, before the longest horizon "
            f"({distribution.longest:g}): "
            "make it without that limit (gymnasium.make with max_episode_steps=-1, envpool.make with a larger one)"
        )


def own_limit(env: Any) -> float:
    """Return the environment's own step limit if it can be read; else infinity.

    Seen are Gymnasium's TimeLimit (also inside a SyncVectorEnv), the limit in the spec of another vector environment,
    and EnvPool's max_episode_steps.

    Args:
        env: Environment or vector environment.
    """
    if isinstance(env, gymnasium.vector.VectorEnv):
        inner: Any = env.unwrapped
        if isinstance(inner, gymnasium.vector.SyncVectorEnv):
            return min(own_limit(part) for part in inner.envs)
        pool = getattr(inner, "config", {})
        pooled = pool.get("max_episode_steps") if isinstance(pool, dict) else None
        remote = isinstance(inner, gymnasium.vector.AsyncVectorEnv)
        spec = inner.get_attr("spec")[0] if remote else getattr(inner, "spec", None)
        known = (pooled, getattr(spec, "max_episode_steps", None), math.inf)
        return min(float(limit) for limit in known if limit is not None and limit > 0)
    limits = [math.inf]
    while isinstance(env, gymnasium.Wrapper):
        if isinstance(env, TimeLimit):
            limits.append(float(env._max_episode_steps))
        env = env.env
    return min(limits)
