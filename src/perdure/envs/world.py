"""`World`, perdure's vector environment: independent lanes, no autoreset, separate `terminated` and `truncated`.

A *lane* is one sub-environment, and the episode that runs in it. Its start states depend on its seed and on its own
earlier episodes, never on its place in the batch nor on its neighbors. Two arrays say how an episode ended: by the task
(`terminated`) or by a limit of the engine (`truncated`). A world has no horizon: the learner counts it
(`learn/rollout.py`), and for other learners `perdure.wrappers` do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from perdure.errors import PerdureError

FloatArray: TypeAlias = npt.NDArray[np.float64]
IntArray: TypeAlias = npt.NDArray[np.int64]
BoolArray: TypeAlias = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class TaskSpec:
    """The description of a task that a policy depends on."""

    name: str
    """Name of the task for `make_world`."""
    suite: str
    """Suite of the task, as in `list_tasks`."""
    engine: str
    """Simulator and version, e.g. "EnvPool 1.2.5, MuJoCo 3.6.0": returns are comparable only under the same one."""
    observation_size: int
    """Length of one observation, after flattening."""
    action_low: FloatArray
    """Lowest action per component, shape (action_size,); read-only."""
    action_high: FloatArray
    """Highest action per component, shape (action_size,); read-only."""
    default_horizon: int
    """Steps per episode the suite itself would use. A fact about the suite: no world applies it."""
    discrete_actions: bool = False
    """Each action component is a whole number from its lowest to its highest (Gymnasium's Discrete, MultiDiscrete and
    MultiBinary); otherwise actions are a box."""
    has_step_limit: bool = True
    """Whether `default_horizon` is the environment's own step limit, and not an assumption."""
    hides_divergence: bool = False
    """Whether a simulation that diverged may be put back to its start without a report, as MuJoCo does in EnvPool."""
    step_seconds: float = np.nan
    """Seconds of one control step; nan: unknown."""
    has_goal: bool = False
    """Its observation holds a desired goal: an episode may be over because the goal is reached."""
    observation_names: tuple[str, ...] = ()
    """Of each component, if the environment says (`unwrapped.observation_names`)."""

    def __post_init__(self) -> None:
        """Keep read-only copies of the bounds, so that no caller can move the box of a running world."""
        for field in ("action_low", "action_high"):
            bound = np.array(getattr(self, field), dtype=np.float64)
            bound.flags.writeable = False
            object.__setattr__(self, field, bound)

    @property
    def action_size(self) -> int:
        """Return the number of action components."""
        return len(self.action_low)


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """The result of one step; row i belongs to the i-th lane that was stepped. All arrays belong to the caller."""

    observations: FloatArray
    """Shape (n, observation_size): the last observation of the step, never one from after a reset."""
    rewards: FloatArray
    """Shape (n,)."""
    terminated: BoolArray
    """Shape (n,): the task itself ended the episode (a fall)."""
    truncated: BoolArray
    """Shape (n,): the engine ended the episode for another reason; never a training horizon."""
    elapsed: IntArray
    """Shape (n,): steps since the lane's reset, this one included."""
    diverged: BoolArray
    """Shape (n,): the engine reports that the simulation diverged in this step. False if the engine cannot report it,
    as in EnvPool; observation and reward then show what the engine did (such as an autoreset)."""
    successes: FloatArray | None = None
    """Shape (n,): 1 where the environment's info reports a success after this step, 0 where it reports that there is
    none, nan where it does not say. None: in no lane it does."""

    @property
    def ended(self) -> BoolArray:
        """Shape (n,): the lane must be reset before it can be stepped again."""
        return self.terminated | self.truncated


class World(Protocol):
    """Many lanes of one task. Implementations never reset a lane by themselves."""

    @property
    def spec(self) -> TaskSpec:
        """Description of the task."""

    @property
    def spaces(self) -> tuple[Any, Any]:
        """Gymnasium's observation and action space of one lane; (None, None) if both are flat vectors."""

    @property
    def num_lanes(self) -> int:
        """Number of lanes."""

    @property
    def elapsed(self) -> IntArray:
        """A copy of each lane's steps since its reset, shape (num_lanes,)."""

    def reset(self, lanes: IntArray | None = None) -> FloatArray:
        """Start a new episode in these lanes; the others are unaffected.

        Args:
            lanes: Lane numbers, shape (n,), each at most once; None for all. Running lanes may be reset too.

        Returns:
            First observations, shape (n, observation_size), rows as in `lanes`.

        Raises:
            PerdureError: If a lane is not legal; nothing was reset.
        """

    def step(self, actions: FloatArray, lanes: IntArray | None = None) -> Step:
        """Move these lanes by one step; the others are unaffected.

        Args:
            actions: Shape (n, action_size), rows as in `lanes`; values outside the box are clipped to it. Discrete
                actions are whole numbers in range.
            lanes: Lane numbers, shape (n,), each at most once; None for all.

        Returns:
            Result of the step, rows as in `lanes`.

        Raises:
            PerdureError: If a lane has ended or was never reset, or an action is NaN or has the wrong shape; nothing
                was stepped.
        """

    def abandon(self, lanes: IntArray) -> None:
        """End the episodes of these lanes from outside; they must be reset before they are stepped again.

        Args:
            lanes: Lane numbers, shape (n,), each at most once. Lanes that have ended already may be among them.

        Raises:
            PerdureError: If a lane does not exist.
        """

    def close(self) -> None:
        """Release the simulators; the world cannot be used afterwards. Closing twice is allowed."""


class TrackedWorld:
    """Base class of worlds: keeps track of which lanes run, and for how many steps.

    Before a world uses its simulator, it calls `lanes_to_reset` or `lanes_to_step`, which only check the arguments.
    Afterwards it calls `begin` or `advance`. A refused call therefore changes nothing.
    """

    spec: TaskSpec
    """See `World.spec`."""
    spaces: tuple[Any, Any] = (None, None)
    """See `World.spaces`."""
    success_key: str | None = None
    """Entry of the environment's infos that `Step.successes` has; None: is_success, or else success."""

    def __init__(self, num_lanes: int) -> None:
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

        Raises:
            PerdureError: If a lane is not legal.
        """
        if self.closed:
            raise PerdureError("This world is closed; build a new one with make_world.")
        if lanes is None:
            return self._everyone
        return checked_lanes(lanes, self.num_lanes)

    def begin(self, chosen: IntArray) -> None:
        """Record that these lanes, which were checked, begin a new episode."""
        self._elapsed[chosen] = 0
        self._begun[chosen] = True
        self._running[chosen] = True

    def lanes_to_step(self, lanes: IntArray | None) -> IntArray:
        """Check a step before it happens and return the lane numbers, shape (n,).

        Raises:
            PerdureError: If a lane does not exist, is named twice, has ended or was never reset.
        """
        chosen = self.lanes_to_reset(lanes)
        running = self._running
        if chosen is not self._everyone:
            running = running[chosen]
        if np.count_nonzero(running) != len(running):  # a third of the time of .all(), at every step
            raise PerdureError(self._why_not(chosen[~running]))
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
        """See `World.abandon`."""
        self._running[self.lanes_to_reset(lanes)] = False

    def _why_not(self, stopped: IntArray) -> str:
        never = stopped[~self._begun[stopped]]
        if len(never):
            return f"Lanes {named_lanes(never)} were never reset; reset them before the first step."
        return f"Lanes {named_lanes(stopped)} have ended; reset them before they are stepped again."


def report_success(world: World, key: str | None) -> World:
    """Return the world, which then reads `Step.successes` from this info; PerdureError if its engine has no infos."""
    if key is not None:
        if not isinstance(world, TrackedWorld) or world.spec.engine.startswith("EnvPool"):
            raise PerdureError(f"{world.spec.name}: success={key!r} names an info, and EnvPool's tasks have none.")
        world.success_key = key
    return world


MAX_SEED = 2**31 - 1  # EnvPool's seeds are int32; one range for all worlds keeps a seed list portable


def checked_lanes(lanes: npt.ArrayLike, num_lanes: int) -> IntArray:
    """Return lane numbers as int64, shape (n,).

    Raises:
        PerdureError: Unless they are whole numbers in [0, num_lanes), each at most once, at least one.
    """
    chosen = _array(lanes)
    if chosen.ndim != 1 or chosen.dtype.kind not in "iu" or chosen.size == 0:
        raise PerdureError(
            f"lanes must be a non-empty list of lane numbers, got shape {chosen.shape} of {chosen.dtype}; "
            "a mask becomes one with numpy.flatnonzero."
        )
    chosen = chosen.astype(np.int64, copy=False)
    # The usual case: ascending, hence unique, and its two ends bound the rest.
    if np.count_nonzero(chosen[1:] > chosen[:-1]) == len(chosen) - 1:
        legal = chosen[0] >= 0 and chosen[-1] < num_lanes
    else:
        legal = chosen.min() >= 0 and chosen.max() < num_lanes
        if legal and np.bincount(chosen, minlength=num_lanes).max() > 1:
            raise PerdureError(f"Lanes must differ from each other, got {named_lanes(chosen)}.")
    if not legal:
        outside = chosen[(chosen < 0) | (chosen >= num_lanes)]
        raise PerdureError(f"Lanes {named_lanes(outside)} do not exist; this world has lanes 0 to {num_lanes - 1}.")
    return chosen


def checked_actions(actions: npt.ArrayLike, chosen: IntArray, spec: TaskSpec) -> FloatArray:
    """Return a copy of actions, clipped to the task's box; discrete actions are refused outside their range.

    Args:
        actions: Shape (n, action_size).
        chosen: Lane numbers for messages, shape (n,).
        spec: Of the task.

    Returns:
        Shape (n, action_size), float64, C-contiguous.

    Raises:
        PerdureError: If the shape is wrong, an entry is NaN, or a discrete action is no whole number in range.
    """
    try:
        values = np.asarray(actions, dtype=np.float64)
    except (TypeError, ValueError):
        raise PerdureError(f"{spec.name}: actions must be an array of numbers, got {type(actions).__name__}.") from None
    expected = (len(chosen), spec.action_size)
    if values.shape != expected:
        raise PerdureError(f"{spec.name}: actions must have shape {expected} (lanes, components), got {values.shape}.")
    if np.count_nonzero(np.isnan(values)):
        row = int(np.flatnonzero(np.isnan(values).any(axis=1))[0])
        raise PerdureError(f"{spec.name}: the action for lane {chosen[row]} is NaN: {values[row]}.")
    if spec.discrete_actions:
        return _checked_discrete(values, chosen, spec)
    clipped = np.empty(expected)
    np.maximum(values, spec.action_low, out=clipped)
    return np.minimum(clipped, spec.action_high, out=clipped)


def _checked_discrete(values: FloatArray, chosen: IntArray, spec: TaskSpec) -> FloatArray:
    legal = (values == np.rint(values)) & (values >= spec.action_low) & (values <= spec.action_high)
    if not legal.all():
        row, component = (int(each[0]) for each in np.nonzero(~legal))
        low = spec.action_low[component]
        high = spec.action_high[component]
        raise PerdureError(
            f"{spec.name}: actions are whole numbers from {low:g} to {high:g}; lane {chosen[row]} got "
            f"{values[row, component]:g}."
        )
    return values.copy()


def checked_seeds(seeds: Sequence[int]) -> list[int]:
    """Return one seed per lane as plain integers.

    Raises:
        PerdureError: Unless they are whole numbers in [0, 2^31), at least one. A seed may appear in many lanes.
    """
    values = _array(seeds)
    if values.ndim != 1 or values.size == 0 or values.dtype.kind not in "iu":
        raise PerdureError(f"seeds must be a non-empty list of whole numbers, one per lane, got {seeds!r}.")
    if values.min() < 0 or values.max() > MAX_SEED:
        bad = values[(values < 0) | (values > MAX_SEED)][0]
        raise PerdureError(f"A seed lies between 0 and {MAX_SEED}, got {bad}.")
    return [int(seed) for seed in values]


def named_lanes(lanes: IntArray, limit: int = 8) -> str:
    """Return lane numbers as text: "3, 5, 8", and how many more there are than `limit`."""
    shown = ", ".join(str(lane) for lane in lanes[:limit])
    if len(lanes) > limit:
        shown += f" and {len(lanes) - limit} more"
    return shown


def _array(values: npt.ArrayLike) -> npt.NDArray[Any]:
    try:
        return np.asarray(values)
    except ValueError:  # lists of different lengths: what is returned fails the caller's check
        return np.asarray(None)
