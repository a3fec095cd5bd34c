"""State of a world's lanes: which run, and for how many steps."""

from __future__ import annotations

from typing import Any

import numpy as np

from perdure.envs.checks import checked_lanes, named_lanes
from perdure.envs.errors import WorldError
from perdure.envs.world import BoolArray, IntArray, TaskSpec


class LaneTracker:
    """Keeps track of which lanes run, and for how many steps.

    Before a world uses its simulator, it calls `lanes_to_reset` or `lanes_to_step`, which only check the arguments.
    Afterwards it calls `begin` or `advance`. A refused call therefore changes neither the world nor the tracker.
    """

    def __init__(self, num_lanes: int) -> None:
        """Start with no lane running.

        Args:
            num_lanes: How many lanes there are, at least one.
        """
        self.num_lanes = num_lanes
        self.closed = False
        self._everyone = np.arange(num_lanes, dtype=np.int64)
        self._everyone.flags.writeable = False
        self._elapsed = np.zeros(num_lanes, dtype=np.int64)
        self._begun = np.zeros(num_lanes, dtype=np.bool_)
        self._running = np.zeros(num_lanes, dtype=np.bool_)

    @property
    def elapsed(self) -> IntArray:
        """A copy of the elapsed steps, shape (num_lanes,)."""
        return self._elapsed.copy()

    @property
    def running(self) -> BoolArray:
        """A copy of which lanes may be stepped, shape (num_lanes,)."""
        return self._running.copy()

    def lanes_to_reset(self, lanes: IntArray | None) -> IntArray:
        """Check a reset before it happens and return the lane numbers, shape (n,).

        Args:
            lanes: As in `World.reset`.

        Raises:
            WorldError: If a lane is not legal.
        """
        return self._chosen(lanes)

    def begin(self, chosen: IntArray) -> None:
        """Record that these lanes begin a new episode.

        Args:
            chosen: Checked lane numbers, shape (n,).
        """
        self._elapsed[chosen] = 0
        self._begun[chosen] = True
        self._running[chosen] = True

    def lanes_to_step(self, lanes: IntArray | None) -> IntArray:
        """Check that these lanes may be stepped.

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

    def advance(self, chosen: IntArray, ended: BoolArray) -> IntArray:
        """Record that these lanes made one step, and return their elapsed steps, shape (n,).

        Args:
            chosen: Checked lane numbers, shape (n,).
            ended: Where the task or the engine ended the episode, shape (n,).
        """
        if chosen is self._everyone:
            self._elapsed += 1
            elapsed = self._elapsed.copy()
        else:
            elapsed = self._elapsed[chosen] + 1
            self._elapsed[chosen] = elapsed
        if np.count_nonzero(ended):
            self._running[chosen[ended]] = False
        return elapsed

    def abandon(self, lanes: IntArray) -> None:
        """Record that the episodes of these lanes end here.

        Args:
            lanes: Lane numbers, shape (n,).

        Raises:
            WorldError: If a lane does not exist or is named twice.
        """
        self._running[self._chosen(lanes)] = False

    def _chosen(self, lanes: IntArray | None) -> IntArray:
        if self.closed:
            raise WorldError("This world is closed; build a new one with make_world.")
        return self._everyone if lanes is None else checked_lanes(lanes, self.num_lanes)

    def _why_not(self, stopped: IntArray) -> str:
        never = stopped[~self._begun[stopped]]
        if len(never):
            return f"Lanes {named_lanes(never)} were never reset; reset them before the first step."
        return f"Lanes {named_lanes(stopped)} have ended; reset them before they are stepped again."


class TrackedWorld:
    """Base class of worlds with a `LaneTracker`."""

    _spec: TaskSpec
    _tracker: LaneTracker
    _space: Any = None
    _action_space: Any = None

    @property
    def spec(self) -> TaskSpec:
        """See `World.spec`."""
        return self._spec

    @property
    def spaces(self) -> tuple[Any, Any]:
        """See `World.spaces`."""
        return self._space, self._action_space

    @property
    def num_lanes(self) -> int:
        """See `World.num_lanes`."""
        return self._tracker.num_lanes

    @property
    def elapsed(self) -> IntArray:
        """See `World.elapsed`."""
        return self._tracker.elapsed

    def abandon(self, lanes: IntArray) -> None:
        """See `World.abandon`."""
        self._tracker.abandon(lanes)
