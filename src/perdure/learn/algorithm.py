"""What a training run knows of an algorithm: its settings, and how it learns in iterations.

A subclass of `Configuration` is an algorithm: its fields are the settings, `make` returns the learner. `perdure train
TASK --method NAME` finds it by its name, also in another package (`perdure.registry`); `--NAME.field` sets a field.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from perdure.errors import PerdureError, lookup
from perdure.horizon import HorizonProtocol
from perdure.registry import Registered

if TYPE_CHECKING:
    from perdure.envs import TaskSpec
    from perdure.envs.traced import WorldSlot
    from perdure.policy import Policy


class Sent(NamedTuple):
    """What one iteration sent to its environments, stepped all together: it leads new ones to the same state."""

    actions: NDArray[np.float32]
    """Before they were cut to the action box, shape (steps, n_envs, action_size); the same steps in every iteration."""
    done: NDArray[np.bool_]
    """Which environments were reset after the step, shape (steps, n_envs)."""
    observations: NDArray[np.float64]
    """Where that led, shape (n_envs, observation_size): after the last step and its resets."""


class Metrics(NamedTuple):
    """What one iteration reports: learning curves, and what a checkpoint within a segment needs."""

    episodes: NDArray[np.float64]
    """A row (step, return, length) for each training episode that ended, shape (episodes, 3)."""
    diagnostics: dict[str, float]
    """The algorithm's own numbers, such as its losses."""
    facts: Mapping[str, float] = {}
    """Further numbers for `Configuration.advice`, reported until the segment ends. Their names have a slash."""
    sent: Sent | None = None
    """None: the run has checkpoints between segments only."""


class Algorithm(Protocol):
    """Learns one task under one configuration. `state` is a tree of arrays, which is all that a checkpoint stores.

    A checkpoint within a segment needs two things more: `Metrics.sent`, and running environments that are such a tree,
    too. What is no array in it (static fields, see `jax.tree_util.register_dataclass`) comes from `start`.
    """

    @property
    def diagnostics(self) -> tuple[str, ...]:
        """Names of `Metrics.diagnostics`, in their order."""

    def init(self, seed: int, start: Policy | None = None) -> Any:
        """Return the state before training, of new weights or of a policy that training continues."""

    def start(self, state: Any, slot: WorldSlot, observations: Any, *, seed: int, segment: int) -> tuple[Any, Any]:
        """Begin a segment: return the state and the running environments, which were reset to `observations`."""

    def iterate(self, state: Any, running: Any, *, seed: int, iteration: int) -> tuple[Any, Any, Metrics]:
        """Learn for one iteration; return both after it. The memory of `state` may be reused."""

    def observation_std(self, state: Any) -> NDArray[np.float64]:
        """Return the spread of each observation component in training so far, shape (observation_size,)."""

    def policy(self, state: Any) -> Policy:
        """Return the policy learned so far, without provenance and reference."""


class Configuration(Registered):
    """Settings of an algorithm, without task and seed. Subclasses are frozen dataclasses with these fields and more."""

    protocol: HorizonProtocol
    """How training treats time: embedding, training horizon T, meaning of its end, discounts."""
    total_steps: int
    """Environment steps to train for, over all environments; rounded up to whole iterations."""
    n_envs: int
    """Environments of one seed, stepped side by side."""
    segment_steps: int
    """Steps between renewals of the environments, where a checkpoint needs no replay; rounded to whole iterations."""
    presets: ClassVar[tuple[str, ...]] = ()
    """Names of its sets of tuned hyperparameters; () where it has one set of defaults."""

    @classmethod
    def methods(cls) -> tuple[str, ...]:
        """Return the training methods that are variants of this algorithm; by default one, of the same name."""
        return (cls.name,)

    @classmethod
    def usual_preset(cls, task: str) -> str | None:
        """Return the preset that a task is trained with by default: the first one; None where there is none."""
        return cls.presets[0] if cls.presets else None

    @classmethod
    @abstractmethod
    def of_method(cls, method: str, task: str, observation_size: int, preset: str | None, limit: int) -> Self:
        """Return the usual settings of one of its methods on a task.

        Args:
            method: One of `methods`.
            task: The task's name, as in `perdure list tasks`.
            observation_size: Length of its observations.
            preset: One of `presets`; None: the usual one.
            limit: Steps after which an episode of the environment ends.
        """

    @abstractmethod
    def make(self, spec: TaskSpec) -> Algorithm:
        """Return the learner of a task with these settings."""

    @property
    @abstractmethod
    def iteration_steps(self) -> int:
        """Return the environment steps of one iteration, over all environments."""

    def continued(self, policy: Policy) -> Self:
        """Return settings with which training may continue a policy; by default it cannot."""
        raise PerdureError(f"--from: {self.name} cannot continue a policy")

    def stages(self, task: str) -> tuple[Stage, ...]:
        """Return the parts of a training run on a task; by default it has one, with these settings."""
        return (Stage(self),)

    def advice(self, facts: Mapping[str, float]) -> str:
        """Return what the user should know, from `Metrics.facts`, as a sentence without a period; "" for nothing."""
        return ""

    @property
    def iterations(self) -> int:
        """Return the iterations in the whole run."""
        return math.ceil(self.total_steps / self.iteration_steps)

    @property
    def segment_iterations(self) -> int:
        """Return the iterations of a segment."""
        return max(1, round(self.segment_steps / self.iteration_steps))

    @property
    def segments(self) -> int:
        """Return the segments of the whole run."""
        return math.ceil(self.iterations / self.segment_iterations)

    def to_json(self) -> dict[str, Any]:
        """Return the settings as plain JSON values."""
        values = {each.name: getattr(self, each.name) for each in fields(self)}  # type: ignore[arg-type]
        values["protocol"] = self.protocol.to_json()
        plain = {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}
        return {"algorithm": self.name, **plain}


@dataclass(frozen=True)
class Stage:
    """A part of a training run. The first one begins as the run does, each later one continues the policy before it."""

    config: Configuration
    disturb: tuple[str, ...] = ()
    """What disturbs its training episodes, beside what disturbs the whole run."""

    @property
    def steps(self) -> int:
        """Return its environment steps."""
        return self.config.iterations * self.config.iteration_steps

    def to_json(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return {"config": self.config.to_json(), "disturb": list(self.disturb)}


def usual_config(
    method: str, task: str, observation_size: int, preset: str | None = None, limit: int = 1000
) -> Configuration:
    """Return the usual settings of a training method, of whatever algorithm, on a task.

    Args:
        method: A method, as `perdure list methods` names it.
        task: The task's name, as in `perdure list tasks`.
        observation_size: Length of its observations.
        preset: The set of hyperparameters; None: the usual one of the task.
        limit: Steps after which an episode of the environment ends; the horizons of the methods scale with it.

    Raises:
        PerdureError: If there is no such method or preset.
    """
    kind = algorithm_of(method)
    if preset is not None and preset not in kind.presets:
        known = ", ".join(kind.presets) or "none"
        raise PerdureError(f"no preset of {kind.name} is named {preset!r}; there are {known}")
    return kind.of_method(method, task, observation_size, preset, limit)


def algorithm_of(method: str) -> type[Configuration]:
    """Return the algorithm that a training method is a variant of.

    Raises:
        PerdureError: If there is no such method.
    """
    return lookup(all_methods(), method, "method")


def all_methods() -> dict[str, type[Configuration]]:
    """Return all training methods, each with its algorithm."""
    return {method: kind for kind in Configuration.kinds().values() for method in kind.methods()}
