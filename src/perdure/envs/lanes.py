"""What every world must know about its lanes, and the checks at its door."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from perdure.envs.errors import WorldError
from perdure.envs.world import BoolArray, FloatArray, IntArray, TaskSpec

MAX_SEED = 2**31 - 1  # EnvPool's seeds are int32; one range for all worlds keeps a seed list portable
NEVER = 2**62  # more steps than any computer makes; an integer's stand-in for infinity


class LaneBook:
    """Which lanes run, how long they have run and how long they may.

    Worlds ask it before they touch their simulator (`lanes_to_reset`, `lanes_to_step`: nothing changes) and tell it
    what happened afterwards (`begin`, `advance`), so a refused call leaves both sides as they were.
    """

    def __init__(self, num_lanes: int) -> None:
        """Starts with no lane running.

        Args:
            num_lanes: How many lanes there are, at least one.
        """
        self.num_lanes = num_lanes
        self.closed = False
        self._everyone = np.arange(num_lanes, dtype=np.int64)
        self._everyone.flags.writeable = False
        self._horizons = np.full(num_lanes, math.inf)
        self._last_step = np.full(num_lanes, NEVER, dtype=np.int64)  # the horizons again: integers compare faster
        self._elapsed = np.zeros(num_lanes, dtype=np.int64)
        self._begun = np.zeros(num_lanes, dtype=np.bool_)
        self._running = np.zeros(num_lanes, dtype=np.bool_)

    @property
    def horizons(self) -> FloatArray:
        """A copy of the horizons, shape (num_lanes,)."""
        return self._horizons.copy()

    @property
    def elapsed(self) -> IntArray:
        """A copy of the elapsed steps, shape (num_lanes,)."""
        return self._elapsed.copy()

    @property
    def running(self) -> BoolArray:
        """A copy of which lanes may be stepped, shape (num_lanes,)."""
        return self._running.copy()

    def lanes_to_reset(self, lanes: IntArray | None, horizons: npt.ArrayLike = math.inf) -> tuple[IntArray, FloatArray]:
        """Checks a reset before it happens.

        Args:
            lanes: As in `World.reset`.
            horizons: As in `World.reset`.

        Returns:
            Lane numbers and their horizons, both of shape (n,).

        Raises:
            WorldError: If a lane or a horizon is not legal.
        """
        chosen = self._chosen(lanes)
        return chosen, checked_horizons(horizons, chosen)

    def begin(self, chosen: IntArray, horizons: FloatArray) -> None:
        """Notes that these lanes have a new episode.

        Args:
            chosen: Checked lane numbers, shape (n,).
            horizons: Checked horizons, shape (n,).
        """
        self._horizons[chosen] = horizons
        self._last_step[chosen] = np.minimum(horizons, NEVER).astype(np.int64)
        self._elapsed[chosen] = 0
        self._begun[chosen] = True
        self._running[chosen] = True

    def lanes_to_step(self, lanes: IntArray | None) -> IntArray:
        """Checks that these lanes may be stepped.

        Args:
            lanes: As in `World.step`.

        Returns:
            Lane numbers, shape (n,).

        Raises:
            WorldError: If a lane does not exist, is named twice, has ended or was never reset.
        """
        chosen = self._chosen(lanes)
        running = self._running if chosen is self._everyone else self._running[chosen]
        if np.count_nonzero(running) != len(running):  # a third of the time of .all(), at every step
            raise WorldError(self._why_not(chosen[~running]))
        return chosen

    def advance(self, chosen: IntArray, engine_end: BoolArray) -> tuple[IntArray, BoolArray]:
        """Notes that these lanes have made one step.

        Args:
            chosen: Checked lane numbers, shape (n,).
            engine_end: Where the task or the engine ended the episode, shape (n,).

        Returns:
            Elapsed steps and where the horizon is complete, both of shape (n,).
        """
        if chosen is self._everyone:
            self._elapsed += 1
            elapsed, last_step = self._elapsed.copy(), self._last_step
        else:
            elapsed, last_step = self._elapsed[chosen] + 1, self._last_step[chosen]
            self._elapsed[chosen] = elapsed
        horizon_end = elapsed >= last_step
        ended = horizon_end | engine_end
        if np.count_nonzero(ended):
            self._running[chosen[ended]] = False
        return elapsed, horizon_end

    def _chosen(self, lanes: IntArray | None) -> IntArray:
        if self.closed:
            raise WorldError("This world is closed; build a new one with make_world.")
        return self._everyone if lanes is None else checked_lanes(lanes, self.num_lanes)

    def _why_not(self, stopped: IntArray) -> str:
        never = stopped[~self._begun[stopped]]
        if len(never):
            return f"Lanes {_short(never)} were never reset; reset them before the first step."
        return f"Lanes {_short(stopped)} have ended; reset them before they are stepped again."


def checked_lanes(lanes: npt.ArrayLike, num_lanes: int) -> IntArray:
    """Lane numbers as an array, or a sentence about what is wrong with them.

    Args:
        lanes: Whole numbers in [0, num_lanes), each at most once, at least one; shape (n,).
        num_lanes: How many lanes exist.

    Returns:
        Shape (n,), int64.

    Raises:
        WorldError: If they are not that.
    """
    chosen = np.asarray(lanes)
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
            raise WorldError(f"Lanes may be named once each, got {_short(chosen)}.")
    if not legal:
        outside = chosen[(chosen < 0) | (chosen >= num_lanes)]
        raise WorldError(f"Lanes {_short(outside)} do not exist; this world has lanes 0 to {num_lanes - 1}.")
    return chosen


def checked_horizons(horizons: npt.ArrayLike, chosen: IntArray) -> FloatArray:
    """Horizons as one number per lane, or a sentence about what is wrong with them.

    Args:
        horizons: One number or shape (n,): whole and at least 1, or infinite.
        chosen: Lane numbers, shape (n,).

    Returns:
        Shape (n,).

    Raises:
        WorldError: If they are not that.
    """
    try:
        values = np.asarray(horizons, dtype=np.float64)
    except (TypeError, ValueError):
        raise WorldError(f"horizons must be numbers of steps, got {horizons!r}.") from None
    if values.ndim and values.shape != chosen.shape:
        raise WorldError(
            f"horizons must be one number or one per lane, shape {chosen.shape}, got shape {values.shape}."
        )
    values = np.broadcast_to(values, chosen.shape)
    legal = (values >= 1) & (values == np.floor(values))  # NaN fails both, infinity passes both
    if not legal.all():
        worst = int(np.flatnonzero(~legal)[0])
        raise WorldError(
            f"A horizon is a whole number of steps, at least 1, or infinite; lane {chosen[worst]} got {values[worst]}."
        )
    return values


def checked_actions(actions: npt.ArrayLike, chosen: IntArray, spec: TaskSpec) -> FloatArray:
    """Actions clipped to the task's box, in an array of our own.

    Args:
        actions: Shape (n, action_size).
        chosen: Lane numbers, shape (n,).
        spec: Whose box it is.

    Returns:
        Shape (n, action_size), float64, C-contiguous.

    Raises:
        WorldError: If the shape is wrong or an entry is NaN.
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
    clipped = np.empty(expected)
    np.maximum(values, spec.action_low, out=clipped)
    return np.minimum(clipped, spec.action_high, out=clipped)


def checked_seeds(seeds: Sequence[int]) -> list[int]:
    """One seed per lane as plain integers.

    Args:
        seeds: At least one whole number in [0, 2^31); the same seed may appear in many lanes.

    Returns:
        The seeds.

    Raises:
        WorldError: If they are not that.
    """
    values = np.asarray(seeds)
    if values.ndim != 1 or values.size == 0 or values.dtype.kind not in "iu":
        raise WorldError(f"seeds must be a non-empty list of whole numbers, one per lane, got {seeds!r}.")
    if values.min() < 0 or values.max() > MAX_SEED:
        bad = values[(values < 0) | (values > MAX_SEED)][0]
        raise WorldError(f"A seed lies between 0 and {MAX_SEED}, got {bad}.")
    return [int(seed) for seed in values]


def _short(lanes: IntArray, limit: int = 8) -> str:
    shown = ", ".join(str(lane) for lane in lanes[:limit])
    return shown if len(lanes) <= limit else f"{shown} and {len(lanes) - limit} more"
