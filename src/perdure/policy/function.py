"""Use any function observations -> actions as a policy."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perdure.envs import batch_of
from perdure.horizon import Clock, LaneClocks
from perdure.policy.errors import PolicyError
from perdure.policy.reference import Reference
from perdure.policy.task import TaskInfo

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FunctionPolicy:
    """A function as a `PolicyLike`. Every call passes all n lanes of a closed loop, ended ones included.

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
      may have the lanes along any axis, as in Stable-Baselines3's ``predict`` of a recurrent policy.
    - ``episode_starts`` is true for every lane in the first call of an episode and false afterwards, shape (n,).
    - ``elapsed`` and ``horizon`` are the output of the clock, shape (n,): the time-to-go is their difference.

    A lane that has ended shows its last observation; what the function answers for it is ignored. So n stays the same,
    and a compiled function is compiled once.
    """

    function: Callable[..., Any]
    task: TaskInfo
    spaces: tuple[Any, Any] = (None, None)
    """Gymnasium's observation and action space of one lane; None: flat vectors."""
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
        return np.zeros(self.task.observation_size) if self.std is None else self.std

    def start(self, clocks: Sequence[Clock | None]) -> _FunctionLanes:
        """See `PolicyLike.start`."""
        return _FunctionLanes(self, clocks)


class _FunctionLanes:
    """See `ActingLanes`: keeps a row for every lane that was started, and the state between calls."""

    def __init__(self, policy: FunctionPolicy, clocks: Sequence[Clock | None]) -> None:
        self._policy = policy
        self._shown = np.zeros((len(clocks), policy.task.observation_size))
        self._running = np.arange(len(clocks))
        known = [clock for clock in clocks if clock is not None]
        self._clocks = LaneClocks(known) if known else None
        self._state: Any = None

    def keep(self, rows: NDArray[np.bool_]) -> None:
        self._running = self._running[rows]

    def act(self, observations: FloatArray, elapsed: int) -> FloatArray:
        self._shown[self._running] = observations
        lanes = len(self._shown)
        seen = batch_of(self._policy.spaces[0], self._shown)
        time = {}
        if self._clocks is not None:
            time = dict(zip(("elapsed", "horizon"), self._clocks.time(np.full(lanes, float(elapsed))), strict=True))
        if self._policy.recurrent:
            starts = np.full(lanes, elapsed == 0)
            returned = self._policy.function(seen, self._state, starts, **time)
            actions, self._state = self._pair(returned)
        else:
            actions = self._policy.function(seen, **time)
        return self._rows(actions, elapsed)[self._running]

    def _pair(self, returned: Any) -> tuple[Any, Any]:
        if not isinstance(returned, tuple) or len(returned) != 2:
            raise PolicyError(
                f"a recurrent function must return (actions, state), it returned {type(returned).__name__}"
            )
        return returned

    def _rows(self, actions: Any, elapsed: int) -> FloatArray:
        """Return actions as rows of finite numbers, shape (lanes, action_size)."""
        task, lanes = self._policy.task, len(self._shown)
        if isinstance(actions, tuple):
            raise PolicyError(
                "the function must return actions, it returned a tuple; of Stable-Baselines3, give "
                "lambda observations: model.predict(observations, deterministic=True)[0], or say recurrent=True"
            )
        try:
            array = np.asarray(actions)
            values = array.astype(np.float64)
        except (TypeError, ValueError, RuntimeError) as error:
            raise PolicyError(f"the function's actions are not an array of numbers: {error}") from None
        shape = self._shape
        if array.shape[:1] != (lanes,) or array.size != lanes * task.action_size:
            raise PolicyError(
                f"the function's actions must have shape {(lanes, *shape)} (lanes, then one action of {task.name}), "
                f"they have {array.shape}"
            )
        values = values.reshape(lanes, task.action_size)
        bad = self._running[~np.isfinite(values[self._running]).all(axis=1)]
        if len(bad):
            raise PolicyError(f"the function's action at step {elapsed + 1} is not finite: {values[bad[0]]}")
        return values

    @property
    def _shape(self) -> tuple[int, ...]:
        space = self._policy.spaces[1]
        return (self._policy.task.action_size,) if space is None else tuple(space.shape)
