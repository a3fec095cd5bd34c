"""Validate what third-party environments return, and name them in error messages.

Gymnasium does not check what an environment returns. NumPy would stretch an observation that shrank to one number over
the whole row, drop the imaginary part of a complex one, and take any text for true.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from perdure.envs.errors import WorldError
from perdure.envs.world import FloatArray

T = TypeVar("T")


def call(where: str, method: str, function: Callable[..., T], *args: Any, **keywords: Any) -> T:
    """Call a method of a third-party environment.

    Args:
        where: Names the environment and, if known, lane and step.
        method: Name of the method, for the message.
        function: The method.
        args: Its arguments.
        keywords: Its keyword arguments.

    Raises:
        WorldError: Whatever it raised, SystemExit included, in one line.
    """
    try:
        return function(*args, **keywords)
    except KeyboardInterrupt:
        raise
    except WorldError:
        raise
    except BaseException as error:
        text = " ".join(str(error).split())
        raise WorldError(f"{where}: {method} raised {type(error).__name__}{f': {text}' if text else ''}") from error


def read_tuple(where: str, method: str, returned: Any, length: int) -> tuple[Any, ...]:
    """Return what a method returned if it is a tuple of this length."""
    if not isinstance(returned, tuple | list) or len(returned) != length:
        found = f"{len(returned)} values" if isinstance(returned, tuple | list) else type(returned).__name__
        raise WorldError(f"{where}: {method} must return {length} values, it returned {found}")
    return tuple(returned)


def read_observation(where: str, method: str, space: Any, observation: Any) -> FloatArray:
    """Return an observation as a vector, shape (flatdim(space),), float64, copied.

    Raises:
        WorldError: If it is not made of real numbers of the shape of its space.
    """
    import gymnasium

    size = gymnasium.spaces.flatdim(space)
    try:
        is_box = isinstance(space, gymnasium.spaces.Box)
        flat = np.asarray(observation if is_box else gymnasium.spaces.flatten(space, observation))
    except Exception as error:
        raise WorldError(f"{where}: {method} returned an observation that does not fit {space}: {error}") from error
    if flat.dtype.kind not in "fiub":
        raise WorldError(f"{where}: {method} returned an observation of {flat.dtype}; it must be real numbers")
    if flat.size != size or (is_box and flat.shape != space.shape and flat.shape != (size,)):
        expected = space.shape if is_box else (size,)
        raise WorldError(f"{where}: {method} returned an observation of shape {flat.shape}, not {expected}")
    return flat.astype(np.float64).ravel()


def read_reward(where: str, reward: Any) -> float:
    """Return a reward as a number.

    Raises:
        WorldError: If it is not one real number.
    """
    value = np.asarray(reward)
    if value.dtype.kind not in "fiub" or value.size != 1:
        raise WorldError(f"{where}: the reward must be a real number, it is {reward!r}")
    return float(value.reshape(()))


def read_flag(where: str, name: str, flag: Any) -> bool:
    """Return `terminated` or `truncated` as a bool; 0 and 1 are taken as well.

    Raises:
        WorldError: If it is anything else.
    """
    value = np.asarray(flag)
    if value.size != 1 or not (
        value.dtype.kind == "b" or (value.dtype.kind in "iu" and int(value.reshape(())) in (0, 1))
    ):
        raise WorldError(f"{where}: {name} must be True or False, it is {flag!r}")
    return bool(value.reshape(()))
