"""Lanes of an evaluation. A lane is one deployed episode: a policy under a clock from a start state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from perdure.envs.checks import MAX_SEED
from perdure.extrapolate.errors import ExtrapolationError
from perdure.horizon import Clock, Constant, Countdown, Periodic, parse_clock

FIRST_EVAL_SEED = 1_000_000
"""Evaluation seed k starts a world from seed FIRST_EVAL_SEED + k."""


@dataclass(frozen=True)
class Extrapolation:
    """A closed-loop evaluation over lanes = policies x clocks x evaluation seeds.

    Raises:
        ExtrapolationError: If there is no lane or no step, or a value is of another kind or out of range.
        HorizonError: If a clock makes no sense.
    """

    policies: tuple[Path, ...]
    """Policies for one task, each as `perdure.policy.find_policy` takes it; texts become paths."""
    steps: int = 100_000
    """T_test: steps of each lane."""
    clocks: tuple[str, ...] = ("default",)
    """Clocks of policies with a time-to-go input: "constant:500", "periodic:500", "countdown:100000", "countdown"
    (to T_test), "default" (each policy's own clock), or "sweep" (the thesis' C: constant 0 to 1000 and periodic 100 to
    1000 in steps of 100, and countdown). Policies without that input run once."""
    eval_seeds: int = 20
    """Start states. The same seed starts from the same state under every policy and clock."""
    first_eval_seed: int = field(default=0, kw_only=True)
    """The first of those seeds: choose a policy or a clock on some seeds, report on others."""
    modules: tuple[str, ...] = field(default=(), kw_only=True)
    """Python modules that policies' tasks may import, as `gymnasium:MODULE:Id` does."""
    max_lanes: int = field(default=48, kw_only=True)
    """Lanes that share one process at a time. Results do not depend on it; a kill costs at most one such group."""

    def __post_init__(self) -> None:
        """Refuse an evaluation of nothing."""
        for name, least in (("steps", 1), ("eval_seeds", 1), ("max_lanes", 1), ("first_eval_seed", 0)):
            object.__setattr__(self, name, whole(name, getattr(self, name), least))
        seeds = MAX_SEED + 1 - FIRST_EVAL_SEED
        if self.first_eval_seed + self.eval_seeds > seeds:
            raise ExtrapolationError(
                f"first_eval_seed + eval_seeds must be at most {seeds}, got {self.first_eval_seed} + {self.eval_seeds}"
            )
        object.__setattr__(self, "policies", tuple(map(Path, _tuple("policies", self.policies, str | Path))))
        for name in ("clocks", "modules"):
            object.__setattr__(self, name, _tuple(name, getattr(self, name), str))
        if not self.policies:
            raise ExtrapolationError("no policy to evaluate: name at least one policy file")
        if not self.clocks:
            raise ExtrapolationError("no clock to evaluate under; leave the option out to use each policy's own")
        self.deployment_clocks(None)

    @property
    def seeds(self) -> range:
        """The evaluation seeds."""
        return range(self.first_eval_seed, self.first_eval_seed + self.eval_seeds)

    def deployment_clocks(self, default: Clock | None) -> tuple[Clock, ...]:
        """Return the clocks of one policy with phi whose own clock is ``default``, each once, in the order given."""
        clocks: list[Clock] = []
        for text in self.clocks:
            if text == "default":
                clocks += [] if default is None else [default]
            elif text == "countdown":
                clocks.append(Countdown(float(self.steps)))
            elif text == "sweep":
                clocks += self._sweep()
            else:
                clocks.append(parse_clock(text))
        return tuple(dict.fromkeys(clocks))

    def _sweep(self) -> list[Clock]:
        constants: list[Clock] = [Constant(float(c)) for c in range(0, 1001, 100)]
        # Periodic(0) is Constant(0), which is there already.
        return [*constants, *(Periodic(float(c)) for c in range(100, 1001, 100)), Countdown(float(self.steps))]


def whole(name: str, value: Any, least: int) -> int:
    """Return a whole number, such as 1000 or 1e3, as an int.

    Raises:
        ExtrapolationError: If it is none, or less than `least`.
    """
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating) or value % 1 != 0:
        raise ExtrapolationError(f"{name} must be a whole number, got {value!r}")
    if value < least:
        raise ExtrapolationError(f"{name} must be at least {least}, got {value}")
    return int(value)


def _tuple(name: str, values: Any, kind: Any) -> tuple[Any, ...]:
    if isinstance(values, str | Path):
        raise ExtrapolationError(f"{name} must be a tuple, got {str(values)!r}; write ({str(values)!r},)")
    what = "strings" if kind is str else "strings or paths"
    if not isinstance(values, Sequence) or not all(isinstance(each, kind) for each in values):
        raise ExtrapolationError(f"{name} must be a list or tuple of {what}, got {values!r}")
    return tuple(values)


@dataclass(frozen=True)
class LaneSpec:
    """One deployed episode: a policy under a clock from a start state."""

    policy: int
    """Index into the policies."""
    clock: Clock | None
    """None for a policy without phi."""
    eval_seed: int


def split(lanes: Sequence[LaneSpec], size: int, parts: int) -> list[list[LaneSpec]]:
    """Return groups of at most ``size`` lanes, of even length, as many for each of ``parts`` workers if possible."""
    rounds = -(-len(lanes) // (size * parts))
    count = min(rounds * parts, len(lanes))
    return [list(lanes[len(lanes) * i // count : len(lanes) * (i + 1) // count]) for i in range(count)]
