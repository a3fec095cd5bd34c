"""A policy: everything that is needed to act, and its provenance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from perdure.errors import PerdureError
from perdure.horizon import Clock, Constant, HorizonProtocol, LaneClocks
from perdure.policy.network import Perceptron, Weights
from perdure.policy.reference import Reference

if TYPE_CHECKING:
    from perdure.envs import TaskSpec

FloatArray = NDArray[np.float64]
CRITIC = "value."
"""Prefix of the names of the critic's weights."""
LARGEST_OBSERVATION = 1e6
"""Clipping bound of observations without a normalizer: far beyond the values of any valid simulation."""
SEEN = "observations"
"""Entry of the provenance: how many observations made the normalizer's statistics, where its file says."""
SMALLEST_EPSILON = 1e-30
"""Stands for 0: adding it to a variance of 1 has no effect."""


@dataclass(frozen=True, eq=False)
class Policy:
    """A deterministic policy: the mean of the trained Gaussian, clipped to the action box or squashed into it.

    Of discrete actions it is the choice with the largest output.

    Raises:
        PerdureError: If weights, normalizer and protocol do not fit together.
    """

    task: TaskInfo
    weights: Weights
    """``policy.{layer}.weight`` (in, out), ``policy.{layer}.bias`` (out,), the same for ``value`` (unless it was left
    out, see :meth:`without_critic`), and ``log_std``."""
    activation: str
    """Between layers; a name of `perdure.policy.network.ACTIVATIONS`, such as "relu" or "tanh"."""
    normalizer: Normalizer
    protocol: HorizonProtocol
    clock: Clock | None = None
    """The policy's default clock; None for a policy without phi."""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    """Method, seed, settings, versions and the command that made it. No time stamps: the same run, the same file."""
    return_scale: float | None = None
    """Rewards were divided by this number in training (the standard deviation of the running discounted return at its
    end), so the critic's output times it is in reward units. None where it is not known."""
    reference: Reference | None = None
    """What the policy does within its training horizon; None where that was not measured."""
    squash: TanhSquash | None = None
    """How the network's output becomes an action: None cuts it to the action box."""

    def __post_init__(self) -> None:
        self._check_networks()
        normalized = self.task.observation_size
        if self.protocol.normalize_embedding:
            normalized += self.protocol.embedding_size
        if self.normalizer.mean.shape != (normalized,) or self.normalizer.var.shape != (normalized,):
            raise PerdureError(f"{self.task.name}: the normalizer must have {normalized} means and variances")
        if (self.clock is None) != (self.protocol.embedding is None):
            raise PerdureError(f"{self.task.name}: a policy has a clock if, and only if, it has an embedding")
        scale = self.return_scale
        if scale is not None and not (isinstance(scale, int | float) and 0 < scale < math.inf):
            raise PerdureError(f"{self.task.name}: return_scale must be a positive number or None, got {scale!r}")
        if self.squash is not None and (self.task.discrete_actions or not np.isfinite(self._box).all()):
            raise PerdureError(f"{self.task.name}: a squashed output needs an action box with finite bounds")
        if self.reference is not None and len(self.reference.observation_low) != self.task.observation_size:
            raise PerdureError(
                f"{self.task.name}: the reference has {len(self.reference.observation_low)} observation components, "
                f"the task {self.task.observation_size}"
            )

    def _check_networks(self) -> None:
        """Raise PerdureError unless actor and critic fit the task and the protocol."""
        expected = self.task.observation_size + self.protocol.embedding_size
        if self._actor.input_size != expected:
            raise PerdureError(
                f"{self.task.name}: the network takes {self._actor.input_size} numbers, but observation "
                f"({self.task.observation_size}) and phi ({self.protocol.embedding_size}) have {expected}"
            )
        networks = [self._actor]
        critic = (expected, 1)
        if self.has_critic:
            networks.append(self._critic)
            critic = (self._critic.input_size, self._critic.output_size)
        if any(each.modulation_size not in (0, self.protocol.embedding_size) for each in networks):
            raise PerdureError(
                f"{self.task.name}: phi has {self.protocol.embedding_size} numbers, but hidden layers are modulated by "
                f"{self._actor.modulation_size}"
            )
        bounds = (len(self.task.action_low), len(self.task.action_high))
        if bounds[0] != bounds[1] or self._actor.output_size != self.task.output_size or critic != (expected, 1):
            raise PerdureError(
                f"{self.task.name}: the networks have {self._actor.output_size} outputs and {critic[1]} value(s) of "
                f"{critic[0]} inputs, but the task has {bounds[0]} lower and {bounds[1]} upper bounds of actions and "
                f"needs {self.task.output_size} outputs, and the value is one number of {expected} inputs"
            )

    @classmethod
    def from_sb3(cls, path: str | Path, env: str, **options: Any) -> Policy:
        """Return the policy in a Stable-Baselines3 zip; `perdure.policy.readers.import_sb3` documents the options."""
        from perdure.policy.readers import import_sb3

        return import_sb3(path, env, **options)

    @classmethod
    def from_cleanrl(cls, path: str | Path, env: str, **options: Any) -> Policy:
        """Return the policy in a CleanRL model; `perdure.policy.readers.import_cleanrl` documents the options."""
        from perdure.policy.readers import import_cleanrl

        return import_cleanrl(path, env, **options)

    @cached_property
    def _actor(self) -> Perceptron:
        return Perceptron(self.weights, "policy", self.activation)

    @cached_property
    def _critic(self) -> Perceptron:
        return Perceptron(self.weights, CRITIC.rstrip("."), self.activation)

    @cached_property
    def _box(self) -> tuple[FloatArray, FloatArray]:
        return np.asarray(self.task.action_low), np.asarray(self.task.action_high)

    def act(self, observations: ArrayLike, elapsed: ArrayLike, clock: Clock | None = None) -> FloatArray:
        """Return actions for observations of shape (n, observation_size): shape (n, action_size), inside the box.

        A row's action does not depend on the other rows, bit for bit.

        Args:
            observations: As the world gives them.
            elapsed: Steps since reset of each row, shape (n,).
            clock: Replaces the policy's own clock; only for a policy with an embedding.

        Raises:
            PerdureError: If shapes do not fit, or a clock is given to a policy without phi.
        """
        clock = clock or self.clock
        steps = np.asarray(elapsed, np.float64)
        if clock is None:
            return self.act_at(observations, steps, np.full(steps.shape, np.inf))
        if self.protocol.embedding is None:
            raise PerdureError(f"this {self.task.name} policy has no time-to-go input, so it takes no clock")
        return self.act_at(observations, *clock.time(steps))

    def act_at(self, observations: ArrayLike, elapsed: ArrayLike, horizons: ArrayLike) -> FloatArray:
        """Act like :meth:`act`, with the output of a clock: phi(elapsed, horizons), shapes (n,)."""
        return np.asarray(self.act_from(self.inputs(observations, self.embed(elapsed, horizons))))

    def act_from(self, inputs: Any) -> Any:
        """Act like :meth:`act`, from what :meth:`inputs` returns, or from a value of it in an ONNX graph."""
        outputs = self._actor(inputs)
        low, high = self._box
        if self.task.discrete_actions:
            return low + self._largest(outputs)
        if self.squash is None:
            actions = outputs.astype(np.float64)
        else:
            actions = self.squash(outputs, low, high)
        actions = np.maximum(actions, low, out=actions)
        return np.minimum(actions, high, out=actions)

    def _largest(self, outputs: NDArray[np.float32]) -> FloatArray:
        """Return which choice of each action component has the largest output, shape (n, action_size)."""
        ends = np.cumsum(self.task.choices)
        parts = np.split(outputs, ends[:-1], axis=1)
        return np.stack([part.argmax(axis=1) for part in parts], axis=1).astype(np.float64)

    def start(self, clocks: Sequence[Clock | None]) -> PolicyEpisodes:
        """Begin episodes, one for each clock; see `perdure.policy.PolicyLike`."""
        return PolicyEpisodes(self, clocks)

    @property
    def has_clock(self) -> bool:
        """Whether the policy has a time-to-go input."""
        return self.protocol.embedding is not None

    @property
    def training_horizon(self) -> float:
        """The longest horizon the policy was trained for, in steps; may be infinite."""
        return float(self.protocol.horizon.longest)

    @property
    def observation_std(self) -> FloatArray:
        """Standard deviation of each observation component in training, shape (observation_size,).

        A policy that sees raw observations does not know it. Its reference episodes stand in: the standard deviation of
        numbers spread evenly over the range that they covered.
        """
        if self.normalizer.is_identity and self.reference is not None:
            width: FloatArray = (self.reference.observation_high - self.reference.observation_low) / math.sqrt(12)
            return width
        std: FloatArray = np.sqrt(self.normalizer.var[: self.task.observation_size])
        return std

    @property
    def has_critic(self) -> bool:
        """Whether the network that estimates returns is there."""
        return any(name.startswith(CRITIC) for name in self.weights)

    def without_critic(self) -> Policy:
        """Return the policy without its critic, at half the size: `value` is no longer available."""
        return replace(self, weights={name: each for name, each in self.weights.items() if not name.startswith(CRITIC)})

    def halved(self) -> Policy:
        """Return a policy of half the size that acts nearly the same: weights are rounded to 16-bit floats.

        Raises:
            PerdureError: If a weight is too large for 16 bits (65,504).
        """
        with np.errstate(over="ignore"):
            short = {name: each.astype(np.float16) for name, each in self.weights.items()}
        for name, each in short.items():
            if not np.isfinite(each).all():
                raise PerdureError(f"{self.task.name}: {name} holds numbers that 16 bits cannot hold")
        return replace(self, weights=short)

    def value(self, observations: ArrayLike, elapsed: ArrayLike, horizons: ArrayLike) -> FloatArray:
        """Return the critic's estimate of the return from here on, in reward units, shape (n,).

        Raises:
            PerdureError: If shapes do not fit, or the critic or the scale of the returns is not in the policy.
        """
        if self.return_scale is None:
            raise PerdureError(
                f"this {self.task.name} policy does not say by what its rewards were divided in training, so its value "
                "is known in scaled reward only: scaled_value"
            )
        return self.scaled_value(observations, elapsed, horizons) * self.return_scale

    def scaled_value(self, observations: ArrayLike, elapsed: ArrayLike, horizons: ArrayLike) -> FloatArray:
        """Return the critic's estimate in rewards as scaled in training, shape (n,).

        Raises:
            PerdureError: If shapes do not fit, or the critic was left out.
        """
        if not self.has_critic:
            raise PerdureError(f"this {self.task.name} policy was saved without its critic, so it has no value")
        inputs = self.inputs(observations, self.embed(elapsed, horizons))
        values: FloatArray = self._critic(inputs)[:, 0].astype(np.float64)
        return values

    def embed(self, elapsed: ArrayLike, horizons: ArrayLike) -> FloatArray:
        """Return phi of these times, float64, shape (n, embedding_size)."""
        phi: FloatArray = self.protocol.embed(np.asarray(elapsed, np.float64), np.asarray(horizons, np.float64))
        return phi

    def inputs(self, observations: ArrayLike, phi: FloatArray) -> NDArray[np.float32]:
        """Return the inputs of the networks: normalized observation and phi, shape (n, input_size), float32."""
        rows = np.asarray(observations, np.float64)
        if rows.ndim != 2 or rows.shape[1] != self.task.observation_size:
            raise PerdureError(
                f"{self.task.name}: observations must have shape (n, {self.task.observation_size}), got {rows.shape}"
            )
        if phi.shape[:-1] != rows.shape[:1]:
            raise PerdureError(f"{self.task.name}: elapsed must have shape ({len(rows)},), got {phi.shape[:-1]}")
        if self.protocol.normalize_embedding:
            return self.normalizer(np.concatenate([rows, phi], axis=1)).astype(np.float32)
        result = np.empty((len(rows), rows.shape[1] + phi.shape[1]), np.float32)
        result[:, : rows.shape[1]] = self.normalizer(rows)
        result[:, rows.shape[1] :] = phi
        return result


class PolicyEpisodes:
    """The running episodes of one `Policy`, one for each clock, see `perdure.policy.closed_loop.ActingEpisodes`.

    A row's action depends on no other row. phi is computed once if all clocks are constant.
    """

    def __init__(self, policy: Policy, clocks: Sequence[Clock | None]) -> None:
        self._policy = policy
        self._set(list(clocks))

    def act(self, observations: FloatArray, elapsed: int) -> FloatArray:
        """See `ActingEpisodes.act`."""
        phi = self._phi
        if phi is None:
            phi = self._embed(elapsed)
        return np.asarray(self._policy.act_from(self._policy.inputs(observations, phi)))

    def keep(self, rows: NDArray[np.bool_]) -> None:
        """See `ActingEpisodes.keep`."""
        self._set([clock for clock, stays in zip(self._clocks, rows, strict=True) if stays])

    def _set(self, clocks: list[Clock | None]) -> None:
        self._clocks = clocks
        known = [clock for clock in clocks if clock is not None]
        self._lane_clocks: LaneClocks | None = None
        if known:
            self._lane_clocks = LaneClocks(known)
        # phi is the same at every step under constant clocks and for policies without phi.
        self._phi: FloatArray | None = None
        if all(isinstance(clock, Constant) for clock in known):
            self._phi = self._embed(0)

    def _embed(self, elapsed: int) -> FloatArray:
        steps = np.full(len(self._clocks), float(elapsed))
        if self._lane_clocks is None:
            return self._policy.embed(steps, steps)
        return self._policy.embed(*self._lane_clocks.time(steps))


@dataclass(frozen=True)
class TaskInfo:
    """The task that a policy was trained on, for checks that a world fits the policy."""

    name: str
    observation_size: int
    action_low: tuple[float, ...]
    action_high: tuple[float, ...]
    discrete_actions: bool = False
    """Whether each action component is a whole number from its lowest to its highest."""

    @classmethod
    def of(cls, spec: TaskSpec) -> Self:
        """Return what a policy keeps of a world's `TaskSpec`."""
        low = tuple(spec.action_low.tolist())
        high = tuple(spec.action_high.tolist())
        return cls(spec.name, spec.observation_size, low, high, spec.discrete_actions)

    @property
    def action_size(self) -> int:
        """Length of one action."""
        return len(self.action_low)

    @property
    def choices(self) -> tuple[int, ...]:
        """How many values each component of a discrete action has."""
        return tuple(int(high - low) + 1 for low, high in zip(self.action_low, self.action_high, strict=True))

    @property
    def output_size(self) -> int:
        """Length of the output of a policy's network: one number for each choice of a discrete action."""
        if self.discrete_actions:
            return sum(self.choices)
        return self.action_size


@dataclass(frozen=True, eq=False)
class Normalizer:
    """Frozen statistics of the observations seen in training; see Stable-Baselines3's ``VecNormalize``."""

    mean: FloatArray
    """Shape (d,); d includes phi only in a replication (``HorizonProtocol.normalize_embedding``)."""
    var: FloatArray
    """Shape (d,)."""
    clip: float = 10.0
    """Normalized values are cut to +-clip."""
    epsilon: float = 1e-8
    """Added to the variance before its square root."""

    @classmethod
    def identity(cls, size: int) -> Normalizer:
        """Return the normalizer of a policy that sees raw observations, up to a size of LARGEST_OBSERVATION."""
        return cls(np.zeros(size), np.ones(size), LARGEST_OBSERVATION, SMALLEST_EPSILON)

    @property
    def is_identity(self) -> bool:
        """Whether observations pass unchanged, so that nothing is known about their spread."""
        return bool(self.epsilon == SMALLEST_EPSILON and not self.mean.any() and (self.var == 1).all())

    @cached_property
    def _std(self) -> FloatArray:
        return np.sqrt(self.var + self.epsilon)

    def __call__(self, observations: FloatArray) -> FloatArray:
        """Return (observations - mean) / sqrt(var + epsilon), clipped to +-clip, in the same shape."""
        scaled = observations - self.mean
        scaled /= self._std
        scaled = np.maximum(scaled, -self.clip, out=scaled)  # np.clip takes longer than the rest together
        return np.minimum(scaled, self.clip, out=scaled)


@dataclass(frozen=True)
class TanhSquash:
    """low + (tanh(output) + 1) / 2 * (high - low), as SAC, TQC and TD3 of Stable-Baselines3 act.

    Raises:
        PerdureError: If the limit is not positive.
    """

    limit: float = math.inf
    """The output is cut to +-limit before tanh; Stable-Baselines3's `clip_mean` (SAC and TQC with `use_sde`)."""

    def __post_init__(self) -> None:
        if not (isinstance(self.limit, int | float) and self.limit > 0):
            raise PerdureError(f"the limit of a squashed output must be a positive number, got {self.limit!r}")

    def __call__(
        self, outputs: NDArray[np.float32], low: NDArray[np.float64], high: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return actions of shape (n, action_size) within the box, from outputs of that shape.

        The arithmetic is of 32 bits, in the order of Stable-Baselines3's `unscale_action`.
        """
        limit = np.float32(self.limit)
        scaled = np.tanh(np.minimum(np.maximum(outputs, -limit), limit))
        low32 = low.astype(np.float32)
        high32 = high.astype(np.float32)
        return (low32 + np.float32(0.5) * (scaled + np.float32(1)) * (high32 - low32)).astype(np.float64)

    def to_json(self) -> dict[str, Any]:
        """Return the squashing as plain JSON values."""
        limit = None  # JSON has no infinity
        if math.isfinite(self.limit):
            limit = float(self.limit)
        return {"name": "tanh", "limit": limit}

    @classmethod
    def from_json(cls, values: Any) -> Self:
        """Return the squashing that :meth:`to_json` described.

        Raises:
            PerdureError: If the values describe none.
        """
        if not isinstance(values, dict) or set(values) != {"name", "limit"} or values["name"] != "tanh":
            raise PerdureError('a squashing is written {"name": "tanh", "limit": a positive number or null}')
        if values["limit"] is None:
            return cls()
        return cls(values["limit"])
