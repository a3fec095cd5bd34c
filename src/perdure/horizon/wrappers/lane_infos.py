"""Read and replace single lanes of the batched observations and info dictionaries of a Gymnasium vector environment.

Gymnasium keeps the entry ``key`` of all lanes in one array and says in the mask ``_key`` which lanes have one.
"""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import iterate
from numpy.typing import NDArray

from perdure.horizon.errors import HorizonError


def lane_info(infos: dict[str, Any], lane: int) -> dict[str, Any]:
    """Return the info dictionary of one lane.

    Args:
        infos: Of all lanes.
        lane: Its number.
    """
    keys = [key for key in infos if f"_{key}" in infos and infos[f"_{key}"][lane]]
    return {key: _entry(infos[key], lane) for key in keys}


def forget_lane(infos: dict[str, Any], lane: int) -> None:
    """Remove one lane's entries, in place; delete an entry that no lane has any more.

    Args:
        infos: Of all lanes.
        lane: Its number.
    """
    for key in [key for key in infos if f"_{key}" in infos and infos[f"_{key}"][lane]]:
        infos[f"_{key}"][lane] = False
        if not infos[f"_{key}"].any():
            del infos[key], infos[f"_{key}"]
        elif isinstance(infos[key], dict):
            forget_lane(infos[key], lane)
        else:
            infos[key][lane] = None if infos[key].dtype == object else 0


def replace_unmasked(infos: dict[str, Any], fresh: dict[str, Any], lanes: NDArray[np.bool_]) -> None:
    """Merge, in place, infos without masks, as EnvPool returns them: one row for each lane that was reset.

    Args:
        infos: Of a step, all lanes.
        fresh: Of a reset of ``lanes`` only.
        lanes: Mask of shape (n,).
    """
    for key, value in infos.items():
        rows = fresh.get(key)
        bare = isinstance(value, np.ndarray) and f"_{key}" not in infos and len(value) == len(lanes)
        if bare and isinstance(rows, np.ndarray) and rows.shape == (lanes.sum(), *value.shape[1:]):
            infos[key] = value.copy()
            infos[key][lanes] = rows


def lane_observation(space: spaces.Space[Any], observations: Any, lane: int) -> Any:
    """Return a copy of one lane's observation.

    Args:
        space: Of the batch.
        observations: Of all lanes.
        lane: Its number.
    """
    return deepcopy(list(iterate(space, observations))[lane])


def replace_lanes(observations: Any, fresh: Any, lanes: NDArray[np.bool_]) -> Any:
    """Return observations with those of ``lanes`` replaced.

    Args:
        observations: Of a step, all lanes: an array, or dictionaries and tuples of arrays.
        fresh: Of a reset with ``reset_mask=lanes``: all lanes (Gymnasium) or only those (EnvPool).
        lanes: Mask of shape (n,).

    Raises:
        HorizonError: If other lanes changed: the environment ignores ``reset_mask`` and has reset them too.
    """
    if isinstance(observations, dict):
        return {key: replace_lanes(value, fresh[key], lanes) for key, value in observations.items()}
    if isinstance(observations, tuple):
        return tuple(replace_lanes(old, new, lanes) for old, new in zip(observations, fresh, strict=True))
    if not isinstance(observations, np.ndarray):
        return fresh
    if len(fresh) != len(lanes):
        rows = observations.copy()
        rows[lanes] = fresh
        return rows
    if not np.array_equal(observations[~lanes], fresh[~lanes], equal_nan=observations.dtype.kind == "f"):
        raise HorizonError(
            "this vector environment ignores options={'reset_mask': ...}, so single lanes cannot be ended from "
            "outside: put HorizonLimit around each environment, inside a SyncVectorEnv"
        )
    return fresh


def _entry(values: Any, lane: int) -> Any:
    if isinstance(values, dict):
        return lane_info(values, lane)
    # Gymnasium makes an object array of NumPy's own bool, but not of Python's.
    return bool(values[lane]) if values.dtype == bool else values[lane]
