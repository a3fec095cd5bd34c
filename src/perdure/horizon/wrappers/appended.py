"""Add phi to an observation and its space: as an entry of a dictionary, or appended to a flat vector."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from perdure.horizon.errors import HorizonError

OBSERVATION, TIME_TO_GO = "observation", "time_to_go"


def appended_space(space: spaces.Space[Any], size: int, as_dict: bool) -> spaces.Space[Any]:
    """Return the space of observations with phi.

    Args:
        space: Space of the observations of one environment.
        size: Numbers in phi.
        as_dict: Dict {"observation", "time_to_go"} instead of one flat Box.

    Raises:
        HorizonError: If a flat vector is asked for and the observations are none of floating-point numbers.
    """
    flat = isinstance(space, spaces.Box) and len(space.shape) == 1 and np.issubdtype(space.dtype, np.floating)
    if not (as_dict or flat):
        raise HorizonError(f"phi cannot be appended to observations in {space}: use dict=True, or flatten them first")
    dtype = space.dtype if isinstance(space, spaces.Box) and flat else np.dtype(np.float32)
    # No bounds: an embedding need not stay in [0, 1].
    phi = spaces.Box(-np.inf, np.inf, (size,), dtype.type)
    if as_dict:
        return spaces.Dict({OBSERVATION: space, TIME_TO_GO: phi})
    assert isinstance(space, spaces.Box)
    return spaces.Box(np.concatenate([space.low, phi.low]), np.concatenate([space.high, phi.high]), dtype=dtype.type)


def append(space: spaces.Space[Any], observation: Any, phi: NDArray[np.float64]) -> Any:
    """Return the observation with phi, as a member of ``space``.

    Args:
        space: From :func:`appended_space`.
        observation: One observation, or a batch of them.
        phi: Shape (size,), or (n, size) for a batch.
    """
    if isinstance(space, spaces.Dict):
        return {OBSERVATION: observation, TIME_TO_GO: phi.astype(space[TIME_TO_GO].dtype)}
    return np.concatenate([observation, phi], axis=-1, dtype=space.dtype)
