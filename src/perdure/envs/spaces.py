"""Gymnasium's spaces as the vectors and the box that the contract speaks of."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from perdure.envs.errors import WorldError
from perdure.envs.world import FloatArray, TaskSpec

if TYPE_CHECKING:
    import gymnasium

UNLIMITED_TASK_HORIZON = 1000
"""Stands in as `TaskSpec.default_horizon` for an environment that states no limit."""


def spec_of(name: str, suite: str, env: Any, spaces: tuple[Any, Any], limit: int | None) -> TaskSpec:
    """Describes a Gymnasium environment.

    Args:
        name: Goes into the spec.
        suite: Goes into the spec.
        env: A single environment or a vector of them; tells the engine.
        spaces: Observation and action space of one lane.
        limit: The environment's own step limit, if it has one.

    Returns:
        Its spec.

    Raises:
        WorldError: If actions are not a box or observations cannot become one vector of fixed length.
    """
    import gymnasium

    observations, actions = spaces
    if not isinstance(actions, gymnasium.spaces.Box):
        raise WorldError(f"{name}: actions must be continuous (a Box), this environment has {actions}.")
    try:
        observation_size = gymnasium.spaces.flatdim(observations)
    except (NotImplementedError, ValueError):
        raise WorldError(
            f"{name}: observations must flatten to one vector of fixed length, this environment has {observations}."
        ) from None
    return TaskSpec(
        name=name,
        suite=suite,
        engine=engine_of(env),
        observation_size=observation_size,
        action_low=actions.low.ravel(),
        action_high=actions.high.ravel(),
        default_horizon=UNLIMITED_TASK_HORIZON if limit is None else limit,
    )


def engine_of(env: Any) -> str:
    """Names the versions an environment runs on.

    Args:
        env: A Gymnasium environment.

    Returns:
        "Gymnasium 1.4.0", and MuJoCo's version where the environment is one of Gymnasium's MuJoCo ones.
    """
    import gymnasium

    engine = f"Gymnasium {gymnasium.__version__}"
    if hasattr(getattr(env, "unwrapped", None), "mujoco_renderer"):
        import mujoco

        engine += f", MuJoCo {mujoco.__version__}"
    return engine


def shaped_actions(space: gymnasium.spaces.Box, actions: FloatArray) -> Any:
    """Action vectors in the shape and number type that an environment asks for.

    Args:
        space: The action space of one lane.
        actions: Shape (n, action_size), clipped.

    Returns:
        Shape (n, *space.shape).
    """
    return actions.reshape(len(actions), *space.shape).astype(space.dtype, copy=False)
