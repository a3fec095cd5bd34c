"""Convert Gymnasium's spaces to the vectors and the action box of `World`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from perdure.envs.errors import WorldError
from perdure.envs.world import FloatArray, TaskSpec

if TYPE_CHECKING:
    import gymnasium

UNLIMITED_TASK_HORIZON = 1000
"""`TaskSpec.default_horizon` of an environment without a step limit."""


def spec_of(name: str, suite: str, env: Any, spaces: tuple[Any, Any], limit: int | None) -> TaskSpec:
    """Describe a Gymnasium environment.

    Args:
        name: Goes into the spec.
        suite: Goes into the spec.
        env: A single environment or a vector of them; determines the engine.
        spaces: Observation and action space of one lane.
        limit: The environment's own step limit, if it has one.

    Returns:
        Its spec.

    Raises:
        WorldError: If actions are neither a box nor discrete, or observations cannot become one vector of fixed length.
    """
    import gymnasium

    observations, actions = spaces
    low, high, discrete = _action_range(name, actions)
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
        action_low=low,
        action_high=high,
        default_horizon=UNLIMITED_TASK_HORIZON if limit is None else limit,
        discrete_actions=discrete,
        has_step_limit=limit is not None,
    )


def _action_range(name: str, space: Any) -> tuple[FloatArray, FloatArray, bool]:
    """Return lowest and highest action per component, shape (action_size,), and whether actions are whole numbers."""
    from gymnasium.spaces import Box, Discrete, MultiBinary, MultiDiscrete

    if isinstance(space, Box):
        return space.low.ravel(), space.high.ravel(), False
    if isinstance(space, Discrete):
        first = float(space.start)
        return np.array([first]), np.array([first + float(space.n) - 1.0]), True
    if isinstance(space, MultiDiscrete):
        low = np.asarray(space.start, np.float64).ravel()
        return low, low + np.asarray(space.nvec, np.float64).ravel() - 1.0, True
    if isinstance(space, MultiBinary):
        size = math.prod(space.shape)
        return np.zeros(size), np.ones(size), True
    raise WorldError(
        f"{name}: actions must be continuous (a Box) or discrete (Discrete, MultiDiscrete, MultiBinary), this "
        f"environment has {space}."
    )


def engine_of(env: Any) -> str:
    """Return the names and versions of an environment's engine.

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


def shaped_actions(space: gymnasium.Space[Any], actions: FloatArray) -> Any:
    """Return action vectors in the shape and dtype of an environment.

    Args:
        space: The action space of one lane.
        actions: Shape (n, action_size), checked.

    Returns:
        Shape (n, *space.shape); (n,) for Discrete.
    """
    return actions.reshape(len(actions), *(space.shape or ())).astype(space.dtype, copy=False)


def batch_of(space: gymnasium.Space[Any] | None, rows: FloatArray) -> Any:
    """Return observation vectors as a batch of the environment's own observation space.

    Args:
        space: The observation space of one lane; None: observations are vectors already.
        rows: Shape (n, observation_size), as `gymnasium.spaces.flatten` makes them.

    Returns:
        An array of shape (n, *space.shape) and the space's number type, in newly allocated memory; for Dict and Tuple a
        dict or tuple of such arrays.
    """
    from gymnasium import spaces

    if space is None:
        return rows.copy()
    if isinstance(space, spaces.Dict):
        return dict(zip(space, _parts(list(space.values()), rows), strict=True))
    if isinstance(space, spaces.Tuple):
        return tuple(_parts(list(space), rows))
    if isinstance(space, spaces.Box | spaces.MultiBinary):
        return rows.reshape(len(rows), *space.shape).astype(space.dtype)
    if isinstance(space, spaces.Discrete):
        return (rows.argmax(axis=1) + int(space.start)).astype(space.dtype)
    return np.stack([spaces.unflatten(space, row) for row in rows])


def _parts(spaces: Sequence[Any], rows: FloatArray) -> list[Any]:
    """Return each part of a composed observation, as a batch."""
    import gymnasium

    ends = np.cumsum([gymnasium.spaces.flatdim(space) for space in spaces])
    return [batch_of(space, part) for space, part in zip(spaces, np.split(rows, ends[:-1], axis=1), strict=True)]
