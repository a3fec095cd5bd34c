"""How training and deployment treat time: the horizon protocol, embeddings, horizon distributions and clocks.

`HorizonProtocol` says how a policy was trained. It has an embedding phi(t, T) of the time-to-go and a distribution of
the training horizon T. At deployment a clock decides which (t, T) the embedding receives. A subclass of `Embedding`,
`Clock` or `HorizonDistribution` is found by its ``name`` in files and on the command line as soon as it is defined.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Literal, Self, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from perdure.errors import PerdureError
from perdure.registry import Registered

__all__ = [
    "Clock",
    "Constant",
    "Countdown",
    "Embedding",
    "End",
    "Fixed",
    "Geometric",
    "HorizonDistribution",
    "HorizonProtocol",
    "Infinite",
    "LaneClocks",
    "Linear",
    "Periodic",
    "TimeFeature",
    "Uniform",
    "geometric_size",
    "parse_clock",
]

End = Literal["terminated", "truncated"]


@dataclass(frozen=True)
class HorizonProtocol:
    """How training treats time: time-to-go input, length of episodes, meaning of their end, discounts.

    gamma = 1 with ``end="truncated"`` is legal, but then values are determined only up to a constant if the task never
    terminates, and V may drift. The same holds for gamma = 1 with an infinite horizon.

    Raises:
        PerdureError: If the parts contradict each other.
    """

    embedding: Embedding | None
    """phi; None if the agent does not observe time."""
    horizon: HorizonDistribution
    """Distribution of the training horizon T."""
    end: End
    """How reaching T counts: ``terminated`` (no value follows) or ``truncated`` (the task continues: bootstrap from the
    last observation)."""
    gamma: float
    """Discount of the objective, in [0, 1]."""
    normalizer_gamma: float
    """Discount of the running return whose standard deviation divides the rewards (VecNormalize's gamma), in [0, 1]."""
    normalize_embedding: bool = False
    """Whether phi passes the observation normalizer, as with VecNormalize in Stable-Baselines3. Off by default, because
    a normalized phi has different meanings in training and at deployment."""

    def __post_init__(self) -> None:
        if not (self.embedding is None or isinstance(self.embedding, Embedding)):
            raise PerdureError(
                f"embedding must be an Embedding, such as Geometric(10), or None, got {self.embedding!r}"
            )
        if not isinstance(self.horizon, HorizonDistribution):
            raise PerdureError(f"horizon must be a HorizonDistribution, such as Fixed(1000), got {self.horizon!r}")
        check_end(self.end)
        for name in ("gamma", "normalizer_gamma"):
            value = getattr(self, name)
            if not (isinstance(value, int | float) and 0 <= value <= 1):
                raise PerdureError(f"{name} must be a number in [0, 1], got {value!r}")
        if not isinstance(self.normalize_embedding, bool):
            raise PerdureError(f"normalize_embedding must be True or False, got {self.normalize_embedding!r}")
        if self.normalize_embedding and self.embedding is None:
            raise PerdureError("normalize_embedding needs an embedding, and this protocol has none")

    @property
    def embedding_size(self) -> int:
        """Return the number of components appended to the observation; 0 without phi."""
        if self.embedding is None:
            return 0
        return self.embedding.size

    def embed(self, elapsed: Any, horizon: Any) -> Any:
        """Return phi, of shape (n, embedding_size), (n, 0) without an embedding.

        Args:
            elapsed: Steps since reset, NumPy or JAX, shape (n,).
            horizon: T, NumPy or JAX, shape (n,); may be infinite.
        """
        if self.embedding is None:
            return (0.0 * elapsed)[..., None][..., :0]
        return self.embedding(elapsed, horizon)

    def to_json(self) -> dict[str, Any]:
        """Return the protocol as plain JSON values."""
        values = {**vars(self), "horizon": self.horizon.to_json()}
        if self.embedding is not None:
            values["embedding"] = self.embedding.to_json()
        return values

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Self:
        """Return the protocol that :meth:`to_json` described.

        Raises:
            PerdureError: If a part is missing, unknown or out of range.
        """
        if not isinstance(values, dict):
            raise PerdureError(f"a horizon protocol is a table of fields, got {values!r}")
        names = {field.name for field in fields(cls)}
        faults = []
        if names - values.keys():
            faults.append(f"missing {', '.join(sorted(names - values.keys()))}")
        if values.keys() - names:
            faults.append(f"unknown {', '.join(sorted(values.keys() - names))}")
        if faults:
            raise PerdureError(f"a horizon protocol cannot be read: {'; '.join(faults)}")
        arguments = {**values, "horizon": HorizonDistribution.from_json(values["horizon"])}
        if values["embedding"] is not None:
            arguments["embedding"] = Embedding.from_json(values["embedding"])
        return cls(**arguments)


def check_end(end: Any) -> None:
    """Raise PerdureError unless `end` is ``"terminated"`` or ``"truncated"``."""
    if end not in get_args(End):
        raise PerdureError(f"end must be one of {', '.join(get_args(End))}, got {end!r}")


# Embeddings


class Embedding(Registered):
    """Map elapsed steps t and a horizon T to the vector appended to the observation.

    Subclasses are frozen dataclasses. They use array operators only, so one body serves Python numbers, NumPy arrays
    and traced JAX arrays. If t > T, no steps are left.
    """

    @property
    @abstractmethod
    def size(self) -> int:
        """Return the length of the vector."""

    @abstractmethod
    def __call__(self, elapsed: Any, horizon: Any) -> Any:
        """Return phi(t, T), of shape (*batch, size).

        Args:
            elapsed: t, steps since reset, shape (*batch,).
            horizon: T, steps the episode may last, shape (*batch,); may be infinite.
        """


@dataclass(frozen=True)
class Geometric(Embedding):
    """phi(t, T) = [lambda_i^(T - t)], lambda_i evenly spaced in [low, high], both ends included (thesis, 3.3.1).

    All ones when nothing is left (t >= T). As the time-to-go grows, every component with lambda < 1 goes to 0.
    The component with lambda = 1 is constant; it is kept, as in the thesis.

    Raises:
        PerdureError: If there is no component, or the factors do not lie in [0, 1] in rising order.
    """

    name: ClassVar[str] = "geometric"

    size: int = 10
    """Number of factors d."""
    low: float = 0.99
    """Smallest factor: forgets all but the last few hundred steps."""
    high: float = 1.0
    """Largest factor."""

    def __post_init__(self) -> None:
        if not isinstance(self.size, int) or self.size < 1:
            raise PerdureError(
                f"a geometric embedding needs a whole number of components, at least 1, got {self.size!r}"
            )
        if not 0 <= self.low <= self.high <= 1:
            raise PerdureError(f"geometric factors must satisfy 0 <= low <= high <= 1, got [{self.low}, {self.high}]")

    @property
    def factors(self) -> NDArray[np.float64]:
        """Return lambda_1, ..., lambda_d, shape (d,)."""
        # A new array each time: JAX remembers an array by identity, in the precision in which it met it first.
        return np.linspace(self.low, self.high, self.size)

    def __call__(self, elapsed: Any, horizon: Any) -> Any:
        """Return phi(t, T), shape (*batch, size); in float32 exact to about 1e-5, in float64 to 1e-12."""
        left = horizon > elapsed
        # max(T - t, 0) by operators, for traced arrays.
        steps_to_go = (horizon - elapsed) * left
        exponent = steps_to_go
        if hasattr(steps_to_go, "ndim"):
            exponent = steps_to_go[..., None]
        if not isinstance(exponent, np.ndarray | float | int):
            return self.factors**exponent
        # With a scalar exponent of 2 NumPy squares instead of calling pow, and the two differ in the last bit under
        # AVX-512. One exponent per factor keeps every row independent of its neighbors.
        factors = self.factors
        if self.size == 1:
            factors = factors.repeat(2)
        return np.power(factors, exponent + 0.0 * factors)[..., : self.size]


@dataclass(frozen=True)
class Linear(Embedding):
    """phi(t, T) = 1 - t/T (Pardo et al., Time limits in reinforcement learning, 2018).

    0 when nothing is left (t >= T, also T = 0), 1 for an infinite horizon. With random horizons the value does
    not determine how many steps are left. Under a constant clock it is 1 for every C > 0.
    """

    name: ClassVar[str] = "linear"

    size = 1

    def __call__(self, elapsed: Any, horizon: Any) -> Any:
        """Return phi(t, T), shape (*batch, 1)."""
        left = horizon > elapsed
        # If no steps are left, T + 1 avoids 0/0 and `left` makes the result 0. Operators only, for traced arrays.
        share = (1.0 - elapsed / (horizon + (1.0 - left))) * left
        return _as_array(share)[..., None]


@dataclass(frozen=True)
class TimeFeature(Embedding):
    """phi(t, T) = min(1, (T - t) / N) with N training steps: what sb3-contrib's `TimeFeatureWrapper` appends.

    The wrapper computes 1 - t/N, which is negative after N steps, and so is phi. `Linear` stays at 0 instead.
    phi under each clock:

    | clock | phi | the same as |
    |---|---|---|
    | `countdown:N` | 1 - t/N, below 0 after N steps | the wrapper |
    | `constant:N` | 1 | the wrapper with `test_mode=True` |
    | `constant:C` | C/N, at most 1 | the wrapper with constant t |
    | `periodic:N` | 1 - (t mod N)/N | the wrapper, reset every N steps |
    | `countdown:C`, C > N | 1 until N steps are left, then down | - |

    The upper limit is 1 because at most N steps were left in training. An infinite T also gives 1.

    Raises:
        PerdureError: If steps is not a whole number of at least 1.
    """

    name: ClassVar[str] = "time_feature"

    steps: int = 1000
    """N, the steps of a training episode (`max_steps`)."""

    def __post_init__(self) -> None:
        _check_steps("the steps of a time feature", self.steps)

    size = 1

    def __call__(self, elapsed: Any, horizon: Any) -> Any:
        """Return phi(t, T), shape (*batch, 1)."""
        # N - (T - t) is t where T = N, so that the quotient is the wrapper's to the last bit.
        share = 1.0 - (self.steps - (horizon - elapsed)) / self.steps
        # A method, not a function of NumPy: t and T may be traced JAX arrays.
        return _as_array(share).clip(max=1.0)[..., None]


def _as_array(value: Any) -> Any:
    """Return an array of NumPy or JAX unchanged, and a Python number as an array."""
    if hasattr(value, "ndim"):
        return value
    return np.asarray(value)


SIZE_BY_TASK = {"Swimmer": 10}
"""Where the thesis contradicts itself (appendix A.2): its text says 10 for every task but Hopper-v3, yet its rule gives
5 for Swimmer-v3 (d = 8) as well. We follow the text, because it names the tasks."""


def geometric_size(observation_size: int, task: str | None = None) -> int:
    """Return the thesis' embedding size: 10 if 10 < 2d/3 for observations of length d, else 5 (appendix A.2).

    For the six tasks: Hopper (d = 11) 5; HalfCheetah, Walker2d (17), Ant (111) and Humanoid (376) 10. Swimmer (d = 8)
    gets 10, against the rule and with the text (SIZE_BY_TASK).

    Args:
        observation_size: Length d of the observation without phi.
        task: The task's name, for the exception.
    """
    if task is not None and robot_of(task) in SIZE_BY_TASK:
        return SIZE_BY_TASK[robot_of(task)]
    if 2 * observation_size > 3 * 10:
        return 10
    return 5


def robot_of(task: str) -> str:
    """Return the robot of a task in any version, of EnvPool or Gymnasium: "gymnasium:Hopper-v5" -> "Hopper"."""
    return task.removeprefix("gymnasium:").split("-")[0]


def usual_preset(task: str) -> str:
    """Return the preset that a task is trained with by default: with RL Zoo's, few Hoppers and Walkers hold."""
    if robot_of(task) in ("Hopper", "Walker2d"):
        return "cleanrl"
    return "zoo"


# Distributions of the training horizon


class HorizonDistribution(Registered):
    """A distribution over horizons. Subclasses are frozen dataclasses and use array operators only."""

    @property
    @abstractmethod
    def longest(self) -> float:
        """Return the longest horizon it draws, in steps; may be infinite."""

    @abstractmethod
    def from_uniform(self, u: Any) -> Any:
        """Return horizons in steps, shaped like ``u``, from numbers drawn uniformly in [0, 1)."""


@dataclass(frozen=True)
class Fixed(HorizonDistribution):
    """T is always ``steps``.

    Raises:
        PerdureError: If steps is not a whole number of at least 1.
    """

    name: ClassVar[str] = "fixed"

    steps: int = 1000
    """T."""

    def __post_init__(self) -> None:
        _check_steps("a fixed horizon", self.steps)

    @property
    def longest(self) -> float:
        """T."""
        return float(self.steps)

    def from_uniform(self, u: Any) -> Any:
        """Return T for every entry."""
        return self.steps + 0.0 * u


@dataclass(frozen=True)
class Uniform(HorizonDistribution):
    """T is a whole number drawn uniformly from {low, ..., high} (thesis, 3.3.2).

    Raises:
        PerdureError: If low or high is not a whole number of at least 1, or low exceeds high.
    """

    name: ClassVar[str] = "uniform"

    low: int = 200
    """T_min."""
    high: int = 1000
    """T_max."""

    def __post_init__(self) -> None:
        _check_steps("the shortest horizon", self.low)
        _check_steps("the longest horizon", self.high)
        if self.low > self.high:
            raise PerdureError(f"the shortest horizon ({self.low}) must not exceed the longest ({self.high})")

    @property
    def longest(self) -> float:
        """T_max."""
        return float(self.high)

    def from_uniform(self, u: Any) -> Any:
        """Return T = low + floor(u * (high - low + 1))."""
        return self.low + (u * (self.high - self.low + 1)) // 1


@dataclass(frozen=True)
class Infinite(HorizonDistribution):
    """T is infinite."""

    name: ClassVar[str] = "infinite"

    longest = math.inf

    def from_uniform(self, u: Any) -> Any:
        """Return infinity for every entry."""
        return math.inf + 0.0 * u


# Clocks


class Clock(Registered):
    """Map elapsed steps since reset to the (t, T) that the embedding receives.

    Subclasses are frozen dataclasses with one number, ``steps``, and use array operators only.

    Raises:
        PerdureError: If steps is negative or nan.
    """

    words: ClassVar[str] = ""
    """What the clock shows, on pages and figures, with {} for its steps; "": its name and its steps."""
    example: ClassVar[float] = 500.0
    """Steps for examples in help texts."""
    place: ClassVar[int] = 50
    """Place on pages among the clocks of a policy, from low to high."""
    is_tuned: ClassVar[bool] = True
    """Whether its steps are a setting to choose, C in figures; else the deployment gives them."""
    steps: float
    """The clock's one setting, in steps."""

    def __post_init__(self) -> None:
        if not self.steps >= 0:
            raise PerdureError(f"a {self.name} clock needs 0 steps or more, got {self.steps}")

    @abstractmethod
    def time(self, elapsed: Any) -> tuple[Any, Any]:
        """Return (t, T) for elapsed steps of shape (n,): two arrays of shape (n,)."""

    @property
    def label(self) -> str:
        """Return a short text for tables, such as "constant(500)"."""
        return f"{self.name}({str(float(self.steps)).removesuffix('.0')})"


@dataclass(frozen=True)
class Constant(Clock):
    """phi(0, C) (thesis, 3.3.3, choice 2).

    C = 0 (no steps left) is out of distribution.
    """

    name: ClassVar[str] = "constant"
    words = "always {} steps to go"
    place = 20

    steps: float
    """C, the steps to go at every step."""

    def time(self, elapsed: Any) -> tuple[Any, Any]:
        """Return (0, C)."""
        return 0 * elapsed, self.steps + 0 * elapsed


@dataclass(frozen=True)
class Countdown(Clock):
    """phi(t, T_test) (thesis, 3.3.3, choice 1). The length of the deployment must be known."""

    name: ClassVar[str] = "countdown"
    words = "countdown from {}"
    example = 1000.0
    place = 10
    is_tuned = False

    steps: float
    """T_test, the steps of the deployment."""

    def time(self, elapsed: Any) -> tuple[Any, Any]:
        """Return (t, T_test)."""
        return elapsed, self.steps + 0 * elapsed


@dataclass(frozen=True)
class Periodic(Clock):
    """phi(t mod C, C) (thesis, 3.3.3, choice 3). Periodic(0) means Constant(0)."""

    name: ClassVar[str] = "periodic"
    words = "countdown from {}, repeated"
    place = 30

    steps: float
    """C, the period."""

    def time(self, elapsed: Any) -> tuple[Any, Any]:
        """Return (t mod C, C)."""
        if self.steps == 0:
            return 0 * elapsed, 0 * elapsed
        return elapsed % self.steps, self.steps + 0 * elapsed


def parse_clock(text: str) -> Clock:
    """Return the clock of a text such as "constant:500", "periodic:200", "countdown:100000", or of a clock's label.

    Raises:
        PerdureError: If the text names no clock, or its number of steps is out of range.
    """
    name, _, steps = text.strip().replace("(", ":").rstrip(")").partition(":")
    try:
        number = float(steps)
    except ValueError:
        raise PerdureError(f"a clock is written name:steps, for example constant:500, got {text!r}") from None
    return Clock.from_json({"name": name, "steps": number})


def clock_examples() -> str:
    """Return all kinds of clocks for help texts: "constant:500, countdown:1000, periodic:500"."""
    return ", ".join(f"{name}:{kind.example:g}" for name, kind in Clock.kinds().items())


class LaneClocks:
    """The clocks of one or more lanes, evaluated in one call. Lanes with equal clocks are evaluated together."""

    def __init__(self, clocks: Sequence[Clock]) -> None:
        if not clocks:
            raise PerdureError("LaneClocks needs at least one clock")
        lanes: dict[Clock, list[int]] = {}
        for lane, clock in enumerate(clocks):
            lanes.setdefault(clock, []).append(lane)
        self._lanes = {clock: np.array(mine) for clock, mine in lanes.items()}
        self._count = len(clocks)

    def time(self, elapsed: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return (t, T) of every lane, two arrays of shape (n,), for steps since reset of shape (n,).

        Raises:
            PerdureError: If the shape does not fit.
        """
        steps = np.asarray(elapsed, np.float64)
        if steps.shape != (self._count,):
            raise PerdureError(f"elapsed must have shape ({self._count},), one number a lane, got {steps.shape}")
        times = np.empty_like(steps)
        horizons = np.empty_like(steps)
        for clock, mine in self._lanes.items():
            times[mine], horizons[mine] = clock.time(steps[mine])
        return times, horizons


def _check_steps(name: str, steps: float) -> None:
    """Refuse a horizon that is not a whole number of steps, at least 1; `name` is for the message."""
    if not (isinstance(steps, int | np.integer) and steps >= 1):  # 1e3 is stored as no whole number
        raise PerdureError(f"{name} must be a whole number of steps, at least 1, got {steps}")
