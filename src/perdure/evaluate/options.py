"""What an evaluation is asked for: the options, declared once for the command line and for Python, and the episodes.

Clocks and disturbances are read when an `Extrapolation` is made. From then on they are objects.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from perdure.disturbances import (
    CALM,
    STANDARD,
    STANDARDS,
    Disturbance,
    check_onsets,
    labels,
    parse_disturbances,
    split_text,
)
from perdure.envs import TaskSpec, World
from perdure.envs.disturbances import DisturbedWorld
from perdure.envs.world import MAX_SEED
from perdure.errors import PerdureError, warn
from perdure.evaluate.episodes import CALM_STEPS, FIRST_EVAL_SEED, EpisodeSpec, whole
from perdure.horizon import Clock, Constant, Countdown, Periodic, parse_clock
from perdure.policy import PolicyLike

CALM_SEEDS = 3
"""Calm start states where none are asked for. Calm episodes of one policy hardly differ."""
DISTURBED_STEPS = 10_000
"""Steps of disturbed episodes where none are asked for."""
DISTURBED_SEEDS = 36
"""Disturbed start states where none are asked for: 36 of 36 that hold show that at least 90 % do."""
OWN_CLOCK = ("default",)
"""The clocks of an evaluation that names none. A function has no clock of its own: it is called without time."""
_LEAST = {"steps": 1, "eval_seeds": 1, "max_episodes": 1, "training_horizon": 1, "first_eval_seed": 0}
"""Smallest value of each whole number."""


@dataclass(frozen=True)
class Condition:
    """Episodes that meet the same disturbances and last equally long."""

    label: str
    """How tables name it: "none", "standard-1", or the disturbances."""
    disturbances: tuple[Disturbance, ...]
    steps: int
    eval_seeds: int
    not_applied: str = ""
    """What the world cannot do, as text."""


Make: TypeAlias = Callable[[Sequence[Disturbance]], World]
"""Builds a world of a task that takes these disturbances, or raises PerdureError."""
ClockChoice: TypeAlias = Clock | Callable[[Clock | None, int], Sequence[Clock]]
"""A clock, or a function that returns clocks: of a policy's own one and the steps of its episodes."""


@dataclass(frozen=True)
class Extrapolation:
    """A closed-loop evaluation over episodes = policies x clocks x evaluation seeds.

    Each field is an option of `perdure.extrapolate` and a flag of `perdure extrapolate`.

    Raises:
        PerdureError: If a value is of another kind or out of range, or a clock or a disturbance makes no sense.
    """

    policies: tuple[Path, ...] = ()
    """Policies for one task, each as `perdure.policy.find_policy` takes it, or ONNX models; texts become paths."""
    env: str | None = field(default=None, kw_only=True)
    """For models and functions: the environment they were trained in. Hopper-v5 is Gymnasium's if Gymnasium can
    make it; envpool:Hopper-v5 is EnvPool's, which is faster; robot.yaml is the contract of a robot."""
    training_horizon: int | None = field(default=None, kw_only=True)
    """For models: steps of a training episode; if left out, what an exported ONNX model says, or the environment's own
    step limit."""
    steps: int | None = None
    """Steps of each calm episode (100,000 by default), or of each under --disturb (10,000). Without --disturb
    36 episodes under standard-1 follow, of 10,000 steps; --disturb none leaves them out."""
    hours: float | None = field(default=None, kw_only=True)
    """In place of --steps: hours of each of those episodes, by the environment's control rate."""
    clocks: tuple[str, ...] = OWN_CLOCK
    """Clocks of policies with a time-to-go input: {clocks}, countdown (to the end),
    default (each policy's own clock), sweep (constant 0 to 1000 and periodic 100 to 1000 in steps of 100, and
    countdown)."""
    eval_seeds: int | None = None
    """Start states, calm (3) or under --disturb (36); the same ones for every policy and clock."""
    first_eval_seed: int = field(default=0, kw_only=True)
    """First start state: choose a policy or a clock on some start states, and report on others."""
    disturb: tuple[str, ...] | None = field(default=None, kw_only=True)
    """none (calm episodes only), standard-1, or what disturbs every episode, all together: {disturbances}.
    push:0.2,0.4 tries each level. strength:0.5@2000 acts from step 2,000 on, strength:0.5@2000+500 for 500 steps.
    Without it: calm episodes and standard-1; discrete actions, or a desired_goal observed: calm only."""
    success: str | None = field(default=None, kw_only=True)
    """Entry of the environment's infos that says after every step whether the goal is reached. If left out, is_success
    or success."""
    max_episodes: int = field(default=48, kw_only=True)
    """Most episodes in one process at a time. Results do not depend on it; a crash costs at most these."""
    modules: tuple[str, ...] = field(default=(), kw_only=True)
    """Python modules that the policies' tasks may import; a policy file alone never imports anything."""

    _clocks: tuple[ClockChoice, ...] = field(init=False, repr=False, compare=False)
    """What `clocks` names."""
    _disturbances: dict[str, tuple[Disturbance, ...]] = field(init=False, repr=False, compare=False)
    """What `disturb` names: label of each condition to the disturbances that act together."""

    def __post_init__(self) -> None:
        for name, least in _LEAST.items():
            if getattr(self, name) is not None:
                self._set(name, whole(name, getattr(self, name), least))
        self._set("policies", tuple(map(Path, _tuple("policies", self.policies, str | Path))))
        for name in ("clocks", "modules", "disturb"):
            if getattr(self, name) is not None:
                self._set(name, _tuple(name, getattr(self, name), str))
        _check_hours(self.hours, self.steps)
        if self.success is not None and not (isinstance(self.success, str) and self.success):
            raise PerdureError(f"success must be the name of an info, such as 'is_success', got {self.success!r}")
        if not self.clocks:
            raise PerdureError("no clock to evaluate under; leave the option out to use each policy's own")
        if self.disturb == ():
            raise PerdureError(f'disturb must name something: ("{CALM}",) disturbs nothing')
        self._set("_clocks", tuple(CLOCK_WORDS.get(text) or parse_clock(text) for text in self.clocks))
        if self.disturb is None:
            self._set("_disturbances", _read_disturbances((CALM,)) | _read_disturbances((STANDARD,)))
        else:
            self._set("_disturbances", _read_disturbances(self.disturb))
        most = MAX_SEED + 1 - FIRST_EVAL_SEED
        asked = max(each.eval_seeds for each in self._asked(1.0))
        if self.first_eval_seed + asked > most:
            raise PerdureError(
                f"first_eval_seed + eval_seeds must be at most {most}, got {self.first_eval_seed} + {asked}"
            )

    def _set(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)  # the dataclass is frozen

    def _asked(self, step_seconds: float) -> list[Condition]:
        """Return the conditions, before it is known what the world can do."""
        steps = self.steps
        if self.hours is not None:
            steps = max(1, round(3600.0 * self.hours / step_seconds))
        asked = []
        for label, disturbances in self._disturbances.items():
            if self.disturb is None and disturbances:  # --steps and --eval-seeds are of the calm episodes
                condition = Condition(label, disturbances, DISTURBED_STEPS, DISTURBED_SEEDS)
            elif disturbances:
                seeds = self.eval_seeds or DISTURBED_SEEDS
                condition = Condition(label, disturbances, steps or DISTURBED_STEPS, seeds)
            else:
                condition = Condition(label, disturbances, steps or CALM_STEPS, self.eval_seeds or CALM_SEEDS)
            asked.append(condition)
        return asked

    def conditions(self, spec: TaskSpec, make: Make) -> list[Condition]:
        """Return the conditions under which policies of a task are evaluated.

        A standard set of disturbances is applied as far as the world can; a task with discrete actions or a goal is
        only then disturbed if that is asked for.

        Args:
            spec: Of the task.
            make: Builds its worlds.

        Raises:
            PerdureError: If the world cannot do what `disturb` names, or does not tell how long a step is for `hours`.
        """
        if self.hours is not None and math.isnan(spec.step_seconds):
            raise PerdureError(f"{spec.name} does not say how long a step is (its attribute dt): give steps, not hours")
        asked = self._asked(spec.step_seconds)
        if self.disturb is None and (spec.discrete_actions or spec.has_goal):
            why = f"{STANDARD}, because {spec.name} has " + ("discrete actions" if spec.discrete_actions else "a goal")
            warn(f"not applied: {why}; name disturbances that it should meet")
            return [replace(asked[0], not_applied=why)]
        for each in asked:
            check_onsets(each.disturbances, each.steps)
        return [_applied(each, spec.name, make) for each in asked]

    def deployment_clocks(self, default: Clock | None, steps: int) -> tuple[Clock, ...]:
        """Return the clocks of one policy with phi, each once, in the order given.

        Args:
            default: The policy's own clock.
            steps: Of the episodes: where a countdown ends.
        """
        clocks: list[Clock] = []
        for choice in self._clocks:
            clocks += [choice] if isinstance(choice, Clock) else choice(default, steps)
        return tuple(dict.fromkeys(clocks))

    def episodes(self, policies: Sequence[PolicyLike], conditions: Sequence[Condition]) -> list[EpisodeSpec]:
        """Return the episodes of these policies, one condition after the other; PerdureError if a policy has none."""
        episodes = []
        for condition in conditions:
            for number, policy in enumerate(policies):
                clocks: Sequence[Clock | None] = (None,)
                if policy.has_clock:
                    clocks = self.deployment_clocks(getattr(policy, "clock", None), condition.steps)
                for clock in clocks:
                    for seed in range(self.first_eval_seed, self.first_eval_seed + condition.eval_seeds):
                        disturbances = condition.disturbances
                        spec = EpisodeSpec(number, clock, seed, disturbances, condition.steps, condition.label)
                        episodes.append(spec)
        if len({each.policy for each in episodes}) < len(policies):
            raise PerdureError("a function or an ONNX model stores no clock; name one, such as constant:500")
        return episodes


def _own(default: Clock | None, steps: int) -> Sequence[Clock]:
    return [] if default is None else [default]


def _to_the_end(default: Clock | None, steps: int) -> Sequence[Clock]:
    return [Countdown(float(steps))]


def _sweep(default: Clock | None, steps: int) -> Sequence[Clock]:
    """Return the C of the thesis."""
    constant = [Constant(float(c)) for c in range(0, 1001, 100)]
    periodic = [Periodic(float(c)) for c in range(100, 1001, 100)]  # Periodic(0) is Constant(0)
    return [*constant, *periodic, Countdown(float(steps))]


CLOCK_WORDS: dict[str, Callable[[Clock | None, int], Sequence[Clock]]] = {
    "default": _own,
    "countdown": _to_the_end,
    "sweep": _sweep,
}
"""Words for clocks that depend on the policy or on the steps of its episodes."""


def _read_disturbances(texts: Sequence[str]) -> dict[str, tuple[Disturbance, ...]]:
    """Return the disturbances of each condition by its label; "push:0.2,0.4" makes two conditions."""
    found: dict[str, tuple[Disturbance, ...]] = {}
    for chosen in product(*map(_levels, texts)):
        disturbances = parse_disturbances(chosen)
        label = chosen[0] if len(chosen) == 1 and chosen[0] in STANDARDS else labels(disturbances)
        found[label] = disturbances
    return found


def _levels(text: str) -> list[str]:
    """Return "push:0.2,0.4" as "push:0.2" and "push:0.4", and "push:0.2,0.4@100" as those of "@100"."""
    name, levels, time = split_text(text)
    if not levels:
        return [text]
    end = f"@{time}" if "@" in text else ""
    return [f"{name}:{level}{end}" for level in levels.split(",")]


def _applied(condition: Condition, task: str, make: Make) -> Condition:
    """Return a condition as a world can do it: of a standard set what it takes; all of others, or PerdureError."""
    if condition.label in STANDARDS:
        able = tuple(each for each in condition.disturbances if _refusal(make, [each]) is None)
        rest = ", ".join(each.name for each in condition.disturbances if each not in able)
        if rest:
            warn(f"{condition.label} is applied without {rest}: {task} cannot do it")
        return replace(condition, disturbances=able, not_applied=rest)
    if condition.disturbances:
        error = _refusal(make, condition.disturbances)
        if error is not None:
            raise error
    return condition


def _refusal(make: Make, disturbances: Sequence[Disturbance]) -> PerdureError | None:
    """Return why a world does not take these disturbances together; None: it does."""
    try:
        with closing(make(disturbances)) as world:
            std = np.zeros((world.num_lanes, world.spec.observation_size))
            DisturbedWorld(world, disturbances, [0] * world.num_lanes, std)
    except PerdureError as error:
        return error
    return None


def _check_hours(hours: Any, steps: int | None) -> None:
    """Refuse hours that are no number above 0, or beside steps."""
    if hours is None:
        return
    if steps is not None:
        raise PerdureError(f"give steps or hours, not both: got {steps} steps and {hours} hours")
    if not (isinstance(hours, int | float) and 0.0 < hours < math.inf):
        raise PerdureError(f"hours must be a number above 0, got {hours!r}")


def _tuple(name: str, values: Any, kind: Any) -> tuple[Any, ...]:
    if isinstance(values, str | Path):
        raise PerdureError(f"{name} must be a tuple, got {str(values)!r}; write ({str(values)!r},)")
    what = "strings" if kind is str else "strings or paths"
    if not isinstance(values, Sequence) or not all(isinstance(each, kind) for each in values):
        raise PerdureError(f"{name} must be a list or tuple of {what}, got {values!r}")
    return tuple(values)
