"""Policies of any origin act in a world, step by step, until every episode has ended.

An episode's trajectory depends on its policy, its clock and its seed alone. Neither its neighbors nor the order of the
episodes change one bit of it, because acting is row-invariant and worlds step lanes independently.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from perdure.envs import FloatArray, IntArray, Step, TaskSpec, World, batch_of
from perdure.envs.gymnasium import call
from perdure.errors import PerdureError
from perdure.horizon import Clock, LaneClocks

if TYPE_CHECKING:
    from perdure.policy.policy import TaskInfo
    from perdure.policy.reference import Reference

# Interface of policies: they act on rows of observations and describe themselves for the evaluation.


class ActingEpisodes(Protocol):
    """The running episodes of one actor in a closed loop."""

    def act(self, observations: FloatArray, elapsed: int) -> FloatArray:
        """Return an action for each running episode.

        Args:
            observations: Shape (n, observation_size), one row for each running episode. Neither changed nor kept.
            elapsed: Steps since reset, the same for all.

        Returns:
            Shape (n, action_size).
        """

    def keep(self, rows: NDArray[np.bool_]) -> None:
        """Drop ended episodes: keep the rows where ``rows``, shape (n,), is true.

        It is called when episodes end, perhaps more than once before the next `act`.
        """


class PolicyLike(Protocol):
    """A policy of any origin. `Policy` is one, `FunctionPolicy` another."""

    @property
    def task(self) -> TaskInfo:
        """The task that it acts on."""

    @property
    def has_clock(self) -> bool:
        """Whether it has a time-to-go input, so that each of its episodes needs a clock."""

    @property
    def training_horizon(self) -> float:
        """The longest horizon it was trained for, in steps; inf if training had none."""

    @property
    def provenance(self) -> Mapping[str, Any]:
        """Its origin: "method" and "seed" among others."""

    @property
    def reference(self) -> Reference | None:
        """Its episodes within its training horizon; None if they were not measured."""

    @property
    def observation_std(self) -> FloatArray:
        """Standard deviation of each observation component in training, shape (observation_size,)."""

    def start(self, clocks: Sequence[Clock | None]) -> ActingEpisodes:
        """Begin episodes, one for each clock; a clock is None exactly if there is no time-to-go input."""


@dataclass(frozen=True, eq=False)
class EpisodePolicy:
    """A policy and the clock that sets its time-to-go input; the clock is None for a policy without that input."""

    policy: PolicyLike
    clock: Clock | None


@dataclass(frozen=True, eq=False)
class LoopStep:
    """One step of the running episodes; row i belongs to episode ``episodes[i]``."""

    episodes: IntArray
    """Episodes that were stepped, shape (n,)."""
    before: FloatArray
    """Observations acted on, shape (n, observation_size)."""
    step: Step
    """Result of the step."""


class ClosedLoop:
    """Step all running episodes until they end; ended episodes leave the batch.

    Args:
        world: Has one lane for each episode; a lane is an episode's place in the batch. Every lane is reset, with no
            horizon.
        policies: The policy of episode 0, 1, ...

    Raises:
        PerdureError: If the numbers of policies and episodes differ, a policy does not fit the world or its clock, or
            an episode starts with an observation that is not finite.
    """

    def __init__(self, world: World, policies: Sequence[EpisodePolicy]) -> None:
        if len(policies) != world.num_lanes:
            raise PerdureError(f"{len(policies)} policies for {world.num_lanes} lanes; each lane needs one")
        for each in policies:
            if (each.clock is not None) != each.policy.has_clock:
                given = "no clock" if each.clock is None else each.clock.label
                raise PerdureError(
                    f"an episode of {each.policy.task.name} needs a clock exactly if its policy has a time-to-go "
                    f"input; this one has {given}"
                )
        for policy in {id(each.policy): each.policy for each in policies}.values():
            check_fit(policy, world)
        self.world = world
        self.observations = world.reset()
        """Current observations of the running episodes, shape (n, observation_size)."""
        if not np.isfinite(self.observations).all():
            episode, component = np.argwhere(~np.isfinite(self.observations))[0]
            raise PerdureError(
                f"{world.spec.name} starts an episode with observation[{component}] = "
                f"{self.observations[episode, component]}; observations must be finite"
            )
        self._elapsed = 0
        self.running: IntArray = np.arange(world.num_lanes)
        """Episodes that the next step will move, shape (n,)."""
        rows: dict[int, list[int]] = {}
        for row, each in enumerate(policies):
            rows.setdefault(id(each.policy), []).append(row)
        self._groups = [
            _Group(policies[mine[0]].policy.start([policies[row].clock for row in mine]), np.array(mine))
            for mine in rows.values()
        ]

    def advance(self) -> LoopStep:
        """Move every running episode by one step; episodes that end in it are not running afterwards."""
        before = self.observations
        actions = self._act(before)
        step = self.world.step(actions, self.running)
        loop_step = LoopStep(self.running, before, step)
        self.observations = step.observations
        self._elapsed += 1
        if step.ended.any():
            self.drop(self.running[step.ended])
        return loop_step

    def drop(self, episodes: NDArray[np.int64]) -> None:
        """Remove episodes; the other episodes are unaffected."""
        stays = ~np.isin(self.running, episodes)
        if stays.all():
            return
        self.world.abandon(self.running[~stays])
        self.observations = self.observations[stays]
        self.running = self.running[stays]
        place = np.cumsum(stays) - 1
        for group in self._groups:
            kept = stays[group.rows]
            if not kept.all():
                group.acting.keep(kept)
            group.rows = place[group.rows[kept]]
        self._groups = [group for group in self._groups if len(group.rows)]

    def _act(self, observations: FloatArray) -> FloatArray:
        if len(self._groups) == 1:
            return self._groups[0].acting.act(observations, self._elapsed)
        actions = np.empty((len(observations), self.world.spec.action_size))
        for group in self._groups:
            actions[group.rows] = group.acting.act(observations[group.rows], self._elapsed)
        return actions


@dataclass(eq=False)
class _Group:
    """The running episodes of one actor."""

    acting: ActingEpisodes
    rows: IntArray
    """Their places among all running episodes, rising."""


def check_fit(policy: PolicyLike, world: World) -> None:
    """Refuse a policy for another task.

    Raises:
        PerdureError: If observation or action sizes, or the action range, differ.
    """
    task = policy.task
    spec = world.spec
    if task.discrete_actions != spec.discrete_actions:
        kind = "discrete" if task.discrete_actions else "continuous"
        other = "continuous" if task.discrete_actions else "discrete"
        raise PerdureError(f"a policy for {task.name} has {kind} actions, those of {spec.name} are {other}")
    same_sizes = task.observation_size == spec.observation_size and task.action_size == spec.action_size
    ranges = (task.action_low, task.action_high), (spec.action_low, spec.action_high)
    # Gymnasium's bounds are of single precision: -0.4 is not -0.4 there.
    if not same_sizes or not np.allclose(*ranges, rtol=1e-6, atol=0.0):
        raise PerdureError(
            f"a policy for {task.name} ({_describe_spaces(task)}) cannot act in {spec.name} ({_describe_spaces(spec)})"
        )


def _describe_spaces(task: TaskInfo | TaskSpec) -> str:
    low = min(task.action_low)
    high = max(task.action_high)
    return f"observations of {task.observation_size}, actions of {task.action_size} from {low:g} to {high:g}"


# Use any function observations -> actions as a policy.


@dataclass(frozen=True, eq=False)
class FunctionPolicy:
    """A function as a `PolicyLike`. Every call passes all n episodes of a closed loop, ended ones included.

    | kind | call | returns |
    |---|---|---|
    | plain | ``function(observations)`` | actions |
    | recurrent | ``function(observations, state, episode_starts)`` | (actions, state) |
    | with a clock | the same with keywords ``elapsed`` and ``horizon`` | the same |

    - ``observations`` have the form of the environment's own, with n in front: shape (n, *shape) for a Box, (n,) for
      Discrete, a dict or tuple of such arrays for Dict and Tuple.
    - ``actions`` likewise: shape (n, *shape) for a Box, whole numbers of shape (n,) for Discrete, (n, k) for
      MultiDiscrete and MultiBinary.
    - ``state`` is the state that the function returned last, None at first. It is passed back unchanged, so its arrays
      may have the episodes along any axis, as in Stable-Baselines3's ``predict`` of a recurrent policy.
    - ``episode_starts`` is true for every row in the first call of an episode and false afterwards, shape (n,).
    - ``elapsed`` and ``horizon`` are the output of the clock, shape (n,): the time-to-go is their difference.

    An episode that has ended shows its last observation; what the function answers for it is ignored. So n stays the
    same, and a compiled function is compiled once.
    """

    function: Callable[..., Any]
    task: TaskInfo
    spaces: tuple[Any, Any] = (None, None)
    """Gymnasium's observation and action space of one episode; None: flat vectors."""
    recurrent: bool = False
    has_clock: bool = False
    """Whether the function has the arguments ``elapsed`` and ``horizon``."""
    training_horizon: float = float("inf")
    """See `PolicyLike.training_horizon`."""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    """See `PolicyLike.provenance`."""
    reference: Reference | None = None
    """See `PolicyLike.reference`."""
    std: FloatArray | None = None
    """See `observation_std`; None: not measured."""

    @property
    def observation_std(self) -> FloatArray:
        """Standard deviation of each observation component within the training horizon; 0 where it is not known."""
        if self.std is None:
            return np.zeros(self.task.observation_size)
        return self.std

    def start(self, clocks: Sequence[Clock | None]) -> _FunctionEpisodes:
        """See `PolicyLike.start`."""
        return _FunctionEpisodes(self, clocks)


class _FunctionEpisodes:
    """See `ActingEpisodes`: keeps a row for every episode that was started, and the state between calls."""

    def __init__(self, policy: FunctionPolicy, clocks: Sequence[Clock | None]) -> None:
        self._policy = policy
        self._shown = np.zeros((len(clocks), policy.task.observation_size))
        self._running = np.arange(len(clocks))
        known = [clock for clock in clocks if clock is not None]
        self._clocks: LaneClocks | None = None
        if known:
            self._clocks = LaneClocks(known)
        self._state: Any = None

    def keep(self, rows: NDArray[np.bool_]) -> None:
        self._running = self._running[rows]

    def act(self, observations: FloatArray, elapsed: int) -> FloatArray:
        self._shown[self._running] = observations
        episodes = len(self._shown)
        seen = batch_of(self._policy.spaces[0], self._shown)
        time = {}
        if self._clocks is not None:
            time["elapsed"], time["horizon"] = self._clocks.time(np.full(episodes, float(elapsed)))
        state: tuple[Any, ...] = ()
        if self._policy.recurrent:
            state = (self._state, np.full(episodes, elapsed == 0))
        where = f"{self._policy.task.name}, step {elapsed + 1}"
        try:
            actions = call(where, "the policy", self._policy.function, seen, *state, **time)
        except PerdureError as error:
            if error.__cause__ is None:  # perdure's own, such as an ONNX model's
                raise
            wanted = (
                f"it gets {episodes} observations at once (with --clocks also elapsed and horizon) and must return "
                f"actions of shape {(episodes, *self._shape)}"
            )
            raise PerdureError(f"{error}; {wanted}") from error.__cause__
        if self._policy.recurrent:
            if not isinstance(actions, tuple) or len(actions) != 2:
                raise PerdureError(
                    f"a recurrent function must return (actions, state), it returned {type(actions).__name__}"
                )
            actions, self._state = actions
        return self._rows(actions, elapsed)[self._running]

    def _rows(self, actions: Any, elapsed: int) -> FloatArray:
        """Return actions as rows of finite numbers, shape (episodes, action_size)."""
        task = self._policy.task
        episodes = len(self._shown)
        if isinstance(actions, tuple):
            raise PerdureError(
                "the function must return actions, it returned a tuple; of Stable-Baselines3, give "
                "lambda observations: model.predict(observations, deterministic=True)[0], or say recurrent=True"
            )
        try:
            array = np.asarray(actions)
            values = array.astype(np.float64)
        except (TypeError, ValueError, RuntimeError) as error:
            raise PerdureError(f"the function's actions are not an array of numbers: {error}") from None
        shape = self._shape
        if array.shape[:1] != (episodes,) or array.size != episodes * task.action_size:
            raise PerdureError(
                f"the function's actions must have shape {(episodes, *shape)} (an action of {task.name} for "
                f"each episode), they have {array.shape}"
            )
        values = values.reshape(episodes, task.action_size)
        bad = self._running[~np.isfinite(values[self._running]).all(axis=1)]
        if len(bad):
            raise PerdureError(f"the function's action at step {elapsed + 1} is not finite: {values[bad[0]]}")
        return values

    @property
    def _shape(self) -> tuple[int, ...]:
        space = self._policy.spaces[1]
        if space is None:
            return (self._policy.task.action_size,)
        return tuple(space.shape)
