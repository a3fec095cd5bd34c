"""`World`, perdure's vector environment: independent lanes, no autoreset, separate `terminated` and `truncated`.

A *lane* is one sub-environment, and the episode that runs in it. Its start states depend on its seed and on its own
earlier episodes, never on its place in the batch nor on its neighbors. Two arrays say how an episode ended: by the task
(`terminated`) or by a limit of the engine (`truncated`). A world has no horizon: the learner counts it
(`learn/rollout.py`), and for other learners `perdure.wrappers` do.

MuJoCo answers a position, velocity or acceleration that is not a number, or is beyond 1e10, by resetting the data to
its start; the counters of these warnings survive that reset (``mj_checkPos``, ``mj_checkVel``, ``mj_checkAcc``).

Gymnasium does not check what an environment returns. NumPy would stretch an observation that shrank to one number over
the whole row, drop the imaginary part of a complex one, and take any text for true.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from perdure.errors import PerdureError

if TYPE_CHECKING:
    import gymnasium

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
        PerdureError: If actions are neither a box nor discrete, or observations cannot become one vector.
    """
    import gymnasium

    observations, actions = spaces
    low, high, discrete = _action_range(name, actions)
    try:
        observation_size = gymnasium.spaces.flatdim(observations)
    except (NotImplementedError, ValueError):
        raise PerdureError(
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
    raise PerdureError(
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


MAX_SEED = 2**31 - 1  # EnvPool's seeds are int32; one range for all worlds keeps a seed list portable


def checked_lanes(lanes: npt.ArrayLike, num_lanes: int) -> IntArray:
    """Return lane numbers as an array, or an error message.

    Args:
        lanes: Whole numbers in [0, num_lanes), each at most once, at least one; shape (n,).
        num_lanes: How many lanes exist.

    Returns:
        Shape (n,), int64.

    Raises:
        PerdureError: If they are not that.
    """
    chosen = _array(lanes)
    if chosen.ndim != 1 or chosen.dtype.kind not in "iu" or chosen.size == 0:
        raise PerdureError(
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
            raise PerdureError(f"Lanes must differ from each other, got {named_lanes(chosen)}.")
    if not legal:
        outside = chosen[(chosen < 0) | (chosen >= num_lanes)]
        raise PerdureError(f"Lanes {named_lanes(outside)} do not exist; this world has lanes 0 to {num_lanes - 1}.")
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
        low, high = spec.action_low[component], spec.action_high[component]
        raise PerdureError(
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
        PerdureError: If they are not that.
    """
    values = _array(seeds)
    if values.ndim != 1 or values.size == 0 or values.dtype.kind not in "iu":
        raise PerdureError(f"seeds must be a non-empty list of whole numbers, one per lane, got {seeds!r}.")
    if values.min() < 0 or values.max() > MAX_SEED:
        bad = values[(values < 0) | (values > MAX_SEED)][0]
        raise PerdureError(f"A seed lies between 0 and {MAX_SEED}, got {bad}.")
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


BAD_STATE_WARNINGS = ("mjWARN_BADQPOS", "mjWARN_BADQVEL", "mjWARN_BADQACC")
"""Names; the numbers differ between versions of MuJoCo."""


def divergence_count(env: Any) -> int:
    """Return the number of MuJoCo's automatic resets after divergence since the last reset of the environment.

    Args:
        env: A Gymnasium environment; one that is not on MuJoCo's own bindings counts 0.
    """
    mujoco = sys.modules.get("mujoco")  # an environment on MuJoCo has imported it
    warnings = getattr(getattr(env.unwrapped, "data", None), "warning", None)
    if mujoco is None or warnings is None:
        return 0
    return sum(int(warnings[int(getattr(mujoco.mjtWarning, name))].number) for name in BAD_STATE_WARNINGS)


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
        PerdureError: Whatever it raised, SystemExit included, in one line.
    """
    try:
        return function(*args, **keywords)
    except KeyboardInterrupt:
        raise
    except PerdureError:
        raise
    except BaseException as error:
        text = " ".join(str(error).split())
        raise PerdureError(f"{where}: {method} raised {type(error).__name__}{f': {text}' if text else ''}") from error


def read_tuple(where: str, method: str, returned: Any, length: int) -> tuple[Any, ...]:
    """Return what a method returned if it is a tuple of this length."""
    if not isinstance(returned, tuple | list) or len(returned) != length:
        found = f"{len(returned)} values" if isinstance(returned, tuple | list) else type(returned).__name__
        raise PerdureError(f"{where}: {method} must return {length} values, it returned {found}")
    return tuple(returned)


def read_observation(where: str, method: str, space: Any, observation: Any) -> FloatArray:
    """Return an observation as a vector, shape (flatdim(space),), float64, copied.

    Raises:
        PerdureError: If it is not made of real numbers of the shape of its space.
    """
    import gymnasium

    size = gymnasium.spaces.flatdim(space)
    try:
        is_box = isinstance(space, gymnasium.spaces.Box)
        flat = np.asarray(observation if is_box else gymnasium.spaces.flatten(space, observation))
    except Exception as error:
        raise PerdureError(f"{where}: {method} returned an observation that does not fit {space}: {error}") from error
    if flat.dtype.kind not in "fiub":
        raise PerdureError(f"{where}: {method} returned an observation of {flat.dtype}; it must be real numbers")
    if flat.size != size or (is_box and flat.shape != space.shape and flat.shape != (size,)):
        expected = space.shape if is_box else (size,)
        raise PerdureError(f"{where}: {method} returned an observation of shape {flat.shape}, not {expected}")
    return flat.astype(np.float64).ravel()


def read_reward(where: str, reward: Any) -> float:
    """Return a reward as a number.

    Raises:
        PerdureError: If it is not one real number.
    """
    value = np.asarray(reward)
    if value.dtype.kind not in "fiub" or value.size != 1:
        raise PerdureError(f"{where}: the reward must be a real number, it is {reward!r}")
    return float(value.reshape(()))


def read_flag(where: str, name: str, flag: Any) -> bool:
    """Return `terminated` or `truncated` as a bool; 0 and 1 are taken as well.

    Raises:
        PerdureError: If it is anything else.
    """
    value = np.asarray(flag)
    if value.size != 1 or not (
        value.dtype.kind == "b" or (value.dtype.kind in "iu" and int(value.reshape(())) in (0, 1))
    ):
        raise PerdureError(f"{where}: {name} must be True or False, it is {flag!r}")
    return bool(value.reshape(()))
