"""Validation of a world's arguments: invalid values never reach a simulator."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from perdure.envs.errors import WorldError
from perdure.envs.world import FloatArray, IntArray, TaskSpec

MAX_SEED = 2**31 - 1  # EnvPool's seeds are int32; one range for all worlds keeps a seed list portable


def checked_lanes(lanes: npt.ArrayLike, num_lanes: int) -> IntArray:
    """Return lane numbers as an array, or an error message.

    Args:
        lanes: Whole numbers in [0, num_lanes), each at most once, at least one; shape (n,).
        num_lanes: How many lanes exist.

    Returns:
        Shape (n,), int64.

    Raises:
        WorldError: If they are not that.
    """
    chosen = _array(lanes)
    if chosen.ndim != 1 or chosen.dtype.kind not in "iu" or chosen.size == 0:
        raise WorldError(
            f"lanes must be a non-empty list of lane numbers, got shape {chosen.shape} of {chosen.dtype}; "
            "a mask becomes one with numpy.flatnonzero."
        )
    chosen = chosen.astype(np.int64, copy=False)
    if (
        np.count_nonzero(chosen[1:] > chosen[:-1]) == len(chosen) - 1
    ):  # the usual case: ascending, hence unique, and its two ends bound the rest
        legal = chosen[0] >= 0 and chosen[-1] < num_lanes
    else:
        legal = chosen.min() >= 0 and chosen.max() < num_lanes
        if legal and np.bincount(chosen, minlength=num_lanes).max() > 1:
            raise WorldError(f"Lanes must differ from each other, got {named_lanes(chosen)}.")
    if not legal:
        outside = chosen[(chosen < 0) | (chosen >= num_lanes)]
        raise WorldError(f"Lanes {named_lanes(outside)} do not exist; this world has lanes 0 to {num_lanes - 1}.")
    return chosen


def checked_actions(actions: npt.ArrayLike, chosen: IntArray, spec: TaskSpec) -> FloatArray:
    """Return a copy of actions, clipped to the task's box; discrete actions are refused outside their range.

    Args:
        actions: Shape (n, action_size).
        chosen: Lane numbers, shape (n,).
        spec: Whose box it is.

    Returns:
        Shape (n, action_size), float64, C-contiguous.

    Raises:
        WorldError: If the shape is wrong, an entry is NaN, or a discrete action is no whole number in range.
    """
    try:
        values = np.asarray(actions, dtype=np.float64)
    except (TypeError, ValueError):
        raise WorldError(f"{spec.name}: actions must be an array of numbers, got {type(actions).__name__}.") from None
    expected = (len(chosen), spec.action_size)
    if values.shape != expected:
        raise WorldError(f"{spec.name}: actions must have shape {expected} (lanes, components), got {values.shape}.")
    if np.count_nonzero(np.isnan(values)):
        row = int(np.flatnonzero(np.isnan(values).any(axis=1))[0])
        raise WorldError(f"{spec.name}: the action for lane {chosen[row]} is NaN: {values[row]}.")
    if spec.discrete_actions:
        return _checked_discrete(values, chosen, spec)
    clipped = np.empty(expected)
    np.maximum(values, spec.action_low, out=clipped)
    return np.minimum(clipped, spec.action_high, out=clipped)


def _checked_discrete(values: FloatArray, chosen: IntArray, spec: TaskSpec) -> FloatArray:
    legal = (values == np.rint(values)) & (values >= spec.action_low) & (values <= spec.action_high)
    if not legal.all():
        row, component = (int(each[0]) for each in np.nonzero(~legal))
        low, high = spec.action_low[component], spec.action_high[component]
        raise WorldError(
            f"{spec.name}: actions are whole numbers from {low:g} to {high:g}; lane {chosen[row]} got "
            f"{values[row, component]:g}."
        )
    return values.copy()


def checked_seeds(seeds: Sequence[int]) -> list[int]:
    """Return one seed per lane as plain integers.

    Args:
        seeds: At least one whole number in [0, 2^31); the same seed may appear in many lanes.

    Returns:
        The seeds.

    Raises:
        WorldError: If they are not that.
    """
    values = _array(seeds)
    if values.ndim != 1 or values.size == 0 or values.dtype.kind not in "iu":
        raise WorldError(f"seeds must be a non-empty list of whole numbers, one per lane, got {seeds!r}.")
    if values.min() < 0 or values.max() > MAX_SEED:
        bad = values[(values < 0) | (values > MAX_SEED)][0]
        raise WorldError(f"A seed lies between 0 and {MAX_SEED}, got {bad}.")
    return [int(seed) for seed in values]


def named_lanes(lanes: IntArray, limit: int = 8) -> str:
    """Return lane numbers as text.

    Args:
        lanes: Shape (n,).
        limit: How many to write out.

    Returns:
        "3, 5, 8", and how many more there are.
    """
    shown = ", ".join(str(lane) for lane in lanes[:limit])
    return shown if len(lanes) <= limit else f"{shown} and {len(lanes) - limit} more"


def _array(values: npt.ArrayLike) -> npt.NDArray[Any]:
    try:
        return np.asarray(values)
    except ValueError:  # lists of different lengths: what is returned fails the caller's check
        return np.asarray(None)
