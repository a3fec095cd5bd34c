"""Episodes far beyond the training horizon: which ones, how they run, and what is recorded of them.

An episode is one deployed run: a policy under a clock from a start state, calm or disturbed. `Extrapolation` says which
ones there are, `evaluate_episodes` runs them.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from itertools import product
from numbers import Real
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from perdure.disturbances import CALM, STANDARD, STANDARDS, Disturbance, labels, parse_disturbances
from perdure.envs import FloatArray, TaskSpec, World, make_world, report_success
from perdure.envs.disturbances import DisturbedWorld, disturbed_task
from perdure.envs.world import MAX_SEED
from perdure.errors import PerdureError, PerdureWarning
from perdure.horizon import Clock, Constant, Countdown, Periodic, parse_clock
from perdure.policy import ClosedLoop, DivergenceDetector, EpisodePolicy, LoopStep, PolicyLike
from perdure.policy.network import one_thread
from perdure.report.schema import MEASURES

FIRST_EVAL_SEED = 1_000_000
"""Evaluation seed k starts a world from seed FIRST_EVAL_SEED + k."""
CALM_STEPS, CALM_SEEDS, DISTURBED_STEPS, DISTURBED_SEEDS = 100_000, 3, 10_000, 36
"""Steps and start states where none are asked for. Calm episodes of one policy hardly differ; 36 of 36 disturbed ones
that hold show that at least 90 % do."""


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


@dataclass(frozen=True)
class Extrapolation:
    """A closed-loop evaluation over episodes = policies x clocks x evaluation seeds.

    Raises:
        PerdureError: If there is no episode or no step, a value is of another kind or out of range, or a clock makes no
            sense.
    """

    policies: tuple[Path, ...]
    """Policies for one task, each as `perdure.policy.find_policy` takes it, or ONNX models; texts become paths."""
    steps: int | None = None
    """T_test: steps of each episode; None: 100,000 calm ones, 10,000 disturbed ones."""
    clocks: tuple[str, ...] = ("default",)
    """Clocks of policies with a time-to-go input: "constant:500", "periodic:500", "countdown:100000", "countdown"
    (to T_test), "default" (each policy's own clock), or "sweep" (the thesis' C: constant 0 to 1000 and periodic 100 to
    1000 in steps of 100, and countdown). Policies without that input run once."""
    eval_seeds: int | None = None
    """Start states; None: 3 calm ones, 36 disturbed ones. The same seed starts from the same state under every policy
    and clock."""
    hours: float | None = field(default=None, kw_only=True)
    """In place of `steps`: hours of each episode, by the environment's own control rate."""
    first_eval_seed: int = field(default=0, kw_only=True)
    """The first of those seeds: choose a policy or a clock on some seeds, report on others."""
    modules: tuple[str, ...] = field(default=(), kw_only=True)
    """Python modules that policies' tasks may import, as `gymnasium:MODULE:Id` does."""
    env: str | None = field(default=None, kw_only=True)
    """For ONNX models: the environment, such as "Hopper-v5" (Gymnasium's) or "envpool:Hopper-v5"."""
    training_horizon: int | None = field(default=None, kw_only=True)
    """For ONNX models: steps of a training episode, within which the reference is measured. None: what an exported
    model says, or the step limit of the environment, 1,000 where it has none."""
    disturb: tuple[str, ...] | None = field(default=None, kw_only=True)
    """What disturbs the episodes, all together, such as "action_noise:0.1" or "push:0.5", or by name, "standard-1"; see
    `perdure.disturbances`. "push:0.2,0.4": episodes under each level. ("none",): nothing. None: both, calm
    episodes and those under standard-1; `steps` and `eval_seeds` are then of the calm ones. The same start state meets
    the same draws under every policy and clock."""
    success: str | None = field(default=None, kw_only=True)
    """Entry of the environment's infos that says after every step whether the goal is reached; None: is_success or
    success, where there is one."""
    max_episodes: int = field(default=48, kw_only=True)
    """Episodes that share one process at a time. Results do not depend on it; a kill costs at most one such group."""

    def __post_init__(self) -> None:
        positive = dict.fromkeys(("steps", "eval_seeds", "max_episodes", "training_horizon"), 1)
        for name, least in {**positive, "first_eval_seed": 0}.items():
            if getattr(self, name) is not None:
                object.__setattr__(self, name, whole(name, getattr(self, name), least))
        if self.hours is not None and self.steps is not None:
            raise PerdureError(f"give steps or hours, not both: got {self.steps} steps and {self.hours} hours")
        if self.hours is not None and not (isinstance(self.hours, int | float) and 0.0 < self.hours < math.inf):
            raise PerdureError(f"hours must be a number above 0, got {self.hours!r}")
        object.__setattr__(self, "policies", tuple(map(Path, _tuple("policies", self.policies, str | Path))))
        for name in ("clocks", "modules", "disturb"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _tuple(name, getattr(self, name), str))
        if self.success is not None and not (isinstance(self.success, str) and self.success):
            raise PerdureError(f"success must be the name of an info, such as 'is_success', got {self.success!r}")
        if not self.policies:
            raise PerdureError("no policy to evaluate: name at least one policy file")
        if not self.clocks:
            raise PerdureError("no clock to evaluate under; leave the option out to use each policy's own")
        self.deployment_clocks(None, 1)
        if self.disturb == ():
            raise PerdureError(f'disturb must name something: ("{CALM}",) disturbs nothing')
        seeds, asked = MAX_SEED + 1 - FIRST_EVAL_SEED, max(each.eval_seeds for each in self._asked(1.0))
        if self.first_eval_seed + asked > seeds:
            raise PerdureError(
                f"first_eval_seed + eval_seeds must be at most {seeds}, got {self.first_eval_seed} + {asked}"
            )

    def _asked(self, step_seconds: float) -> list[Condition]:
        """Return the conditions, before it is known what the world can do."""
        steps = self.steps if self.hours is None else max(1, round(3600.0 * self.hours / step_seconds))
        calm = Condition(CALM, (), steps or CALM_STEPS, self.eval_seeds or CALM_SEEDS)
        disturbed = replace(calm, steps=steps or DISTURBED_STEPS, eval_seeds=self.eval_seeds or DISTURBED_SEEDS)
        if self.disturb is None:
            standard = parse_disturbances([STANDARD])
            return [calm, Condition(STANDARD, standard, DISTURBED_STEPS, DISTURBED_SEEDS)]
        found = []
        for texts in product(*map(_levels, self.disturb)):
            each = parse_disturbances(texts)
            label = texts[0] if len(texts) == 1 and texts[0] in STANDARDS else labels(each)
            found.append(replace(disturbed, label=label, disturbances=each) if each else calm)
        return list(dict.fromkeys(found))

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
        asked, found = self._asked(spec.step_seconds), list[Condition]()
        if self.disturb is None and (spec.discrete_actions or spec.has_goal):
            why = f"{STANDARD}, because {spec.name} has " + ("discrete actions" if spec.discrete_actions else "a goal")
            warnings.warn(f"not applied: {why}; name disturbances that it should meet", PerdureWarning, stacklevel=3)
            return [replace(asked[0], not_applied=why)]
        for each in asked:
            if each.label in STANDARDS:
                able = tuple(one for one in each.disturbances if _refusal(make, [one]) is None)
                rest = ", ".join(one.name for one in each.disturbances if one not in able)
                each = replace(each, disturbances=able, not_applied=rest)
                if rest:
                    words = f"{each.label} is applied without {rest}: {spec.name} cannot do it"
                    warnings.warn(words, PerdureWarning, stacklevel=3)
            elif each.disturbances and (error := _refusal(make, each.disturbances)) is not None:
                raise error
            found.append(each)
        return found

    def deployment_clocks(self, default: Clock | None, steps: int) -> tuple[Clock, ...]:
        """Return the clocks of one policy with phi, each once, in the order given.

        Args:
            default: The policy's own clock.
            steps: Of the episodes: where a countdown ends.
        """
        clocks: list[Clock] = []
        for text in self.clocks:
            if text == "default":
                clocks += [] if default is None else [default]
            elif text == "countdown":
                clocks.append(Countdown(float(steps)))
            elif text == "sweep":
                clocks += [Constant(float(c)) for c in range(0, 1001, 100)]
                clocks += [Periodic(float(c)) for c in range(100, 1001, 100)]  # Periodic(0) is Constant(0)
                clocks.append(Countdown(float(steps)))
            else:
                clocks.append(parse_clock(text))
        return tuple(dict.fromkeys(clocks))


def _refusal(make: Make, disturbances: Sequence[Disturbance]) -> PerdureError | None:
    """Return why a world does not take these disturbances together; None: it does."""
    try:
        with closing(make(disturbances)) as world:
            std = np.zeros((world.num_lanes, world.spec.observation_size))
            DisturbedWorld(world, disturbances, [0] * world.num_lanes, std)
    except PerdureError as error:
        return error
    return None


def _levels(text: str) -> list[str]:
    """Return "push:0.2,0.4" as "push:0.2" and "push:0.4"."""
    name, colon, levels = text.partition(":")
    return [f"{name}{colon}{level}" for level in levels.split(",")]


def whole(name: str, value: Any, least: int) -> int:
    """Return a whole number, such as 1000 or 1e3, as an int; PerdureError if it is none, or less than `least`."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating) or value % 1 != 0:
        raise PerdureError(f"{name} must be a whole number, got {value!r}")
    if value < least:
        raise PerdureError(f"{name} must be at least {least}, got {value}")
    return int(value)


def _tuple(name: str, values: Any, kind: Any) -> tuple[Any, ...]:
    if isinstance(values, str | Path):
        raise PerdureError(f"{name} must be a tuple, got {str(values)!r}; write ({str(values)!r},)")
    what = "strings" if kind is str else "strings or paths"
    if not isinstance(values, Sequence) or not all(isinstance(each, kind) for each in values):
        raise PerdureError(f"{name} must be a list or tuple of {what}, got {values!r}")
    return tuple(values)


@dataclass(frozen=True)
class EpisodeSpec:
    """One deployed run: a policy under a clock from a start state, calm or disturbed."""

    policy: int
    """Index into the policies."""
    clock: Clock | None
    """None for a policy without phi."""
    eval_seed: int
    disturbances: tuple[Disturbance, ...] = ()
    steps: int = CALM_STEPS
    """How long it lasts, unless it ends earlier."""
    label: str = ""
    """How tables name the disturbances; "": by their own labels."""

    @property
    def disturbance(self) -> str:
        """The label of its condition, such as "none" or "standard-1"."""
        return self.label or labels(self.disturbances)


def split(episodes: Sequence[EpisodeSpec], size: int, parts: int) -> list[list[EpisodeSpec]]:
    """Return groups of at most ``size`` episodes of all policies, as many for each of ``parts`` workers if possible."""
    rounds = -(-len(episodes) // (size * parts))
    count = min(rounds * parts, len(episodes))
    return [list(episodes[first::count]) for first in range(count)]


PER_DECADE = 10
"""Recorded steps for each factor of ten, so that a plot on a log axis is smooth."""
FEWEST_RECORDED_WINDOWS = 100
MOST_RECORDED_WINDOWS = 1000
"""Evenly spaced recorded steps, so that a plot on a linear axis is smooth. Rewards between two of them are judged."""
WINDOW = 1000
"""Steps between two evenly spaced ones, if their number allows it: the length of an ordinary episode."""


def window_steps(steps: int) -> NDArray[np.int64]:
    """Return rising step numbers, evenly spaced, up to ``steps``."""
    count = min(steps, max(FEWEST_RECORDED_WINDOWS, min(MOST_RECORDED_WINDOWS, steps // WINDOW)))
    return np.ceil(np.linspace(0, steps, count + 1)[1:]).astype(np.int64)


def recorded_steps(steps: int) -> NDArray[np.int64]:
    """Return rising step numbers from 1 to ``steps``, evenly spaced on a log axis and on a linear axis."""
    decades = np.log10(steps)
    log = np.round(np.logspace(0, decades, int(np.ceil(decades * PER_DECADE)) + 1))
    return np.unique(np.concatenate([log, window_steps(steps), [steps]])).astype(np.int64)


EVERY, SPAN = 10, 10
"""Steps between two measurements, as events last much longer; measurements until movement has a new origin."""
MARGIN = 0.5
"""A component has left its training range if it is outside by more than this share of the range."""


class MovementRecorder:
    """Mean movement in the first and the last tenth of the test horizon, and training ranges left.

    Movement: mean over components of |o_t - o_s| in training standard deviations, s being the start of each 100 steps.
    Over single steps it would depend on the control rate.
    """

    def __init__(self, policies: list[PolicyLike], steps: int) -> None:
        episodes, size = len(policies), policies[0].task.observation_size
        std = np.stack([policy.observation_std for policy in policies])
        self._per_deviation = np.where(std > 1e-6, 1.0 / np.maximum(std, 1e-6), 0.0)
        self._low, self._high = np.full((episodes, size), -np.inf), np.full((episodes, size), np.inf)
        for episode, policy in enumerate(policies):
            if policy.reference is not None:
                low, high = policy.reference.observation_low, policy.reference.observation_high
                self._low[episode], self._high[episode] = low - MARGIN * (high - low), high + MARGIN * (high - low)
        self._tenth, self._last_start = max(1, steps // 10), steps - max(1, steps // 10)
        self._sums, self._counts = np.zeros((2, episodes)), np.zeros((2, episodes))
        self._origin = np.zeros((episodes, size))
        self.left_step = np.zeros(episodes, np.int64)
        """Step at which a component was first seen outside; 0: never."""
        self.left_component = np.full(episodes, -1)

    def take(self, loop_step: LoopStep, step: int) -> None:
        """Record the episodes of this step, if it is a recording step."""
        if step % EVERY:
            return
        episodes, after = loop_step.episodes, loop_step.step.observations
        part = 0 if step <= self._tenth else 1 if step > self._last_start else None
        with np.errstate(invalid="ignore", over="ignore"):
            if part is not None:
                renewed = self._counts[part, episodes] % SPAN == 0
                self._origin[episodes[renewed]] = loop_step.before[renewed]
                moved = (np.abs(after - self._origin[episodes]) * self._per_deviation[episodes]).mean(axis=1)
                known = np.isfinite(moved)
                self._sums[part, episodes[known]] += moved[known]
                self._counts[part, episodes[known]] += 1
            outside = (after < self._low[episodes]) | (after > self._high[episodes])
        new = outside.any(axis=1) & (self.left_step[episodes] == 0)
        self.left_step[episodes[new]] = step
        self.left_component[episodes[new]] = outside[new].argmax(axis=1)

    @property
    def movement(self) -> NDArray[np.float64]:
        """Mean movement in the first and the last tenth, shape (2, episodes); nan where nothing was seen."""
        with np.errstate(invalid="ignore"):
            return self._sums / self._counts


class GoalRecorder:
    """First success, longest stay at the goal and success at the last step: `found`, see `EpisodeRecords.goals`."""

    def __init__(self, episodes: int) -> None:
        self.found, self._stay = np.full((3, episodes), np.nan), np.zeros(episodes)

    def take(self, episodes: NDArray[np.int64], successes: FloatArray | None, step: int) -> None:
        """Record a step of these episodes, see `Step.successes`. A step that does not say is no success."""
        first, longest, _ = self.found[:, episodes]
        said = np.full(len(episodes), np.nan) if successes is None else successes
        known, now = ~np.isnan(said) | ~np.isnan(first), said == 1.0
        self._stay[episodes] = stay = np.where(now, self._stay[episodes] + 1.0, 0.0)
        found = [np.fmin(first, np.where(now, step, np.inf)), np.fmax(longest, stay), now]
        self.found[:, episodes] = np.where(known, found, np.nan)


SURVIVED, TERMINATED, TRUNCATED, DIVERGED = range(4)


@dataclass(frozen=True, eq=False)
class EpisodeRecords:
    """Results of n episodes at m recorded steps. Memory hardly depends on the number of steps."""

    steps: NDArray[np.int64]
    """Recorded steps, shape (m,)."""
    returns: NDArray[np.float64]
    """Cumulative return at each recorded step, shape (n, m); an ended episode keeps its last value."""
    end_step: NDArray[np.int64]
    """Steps the episode made, its last one included, shape (n,)."""
    end_reason: NDArray[np.int64]
    """Index into END_REASONS, shape (n,)."""
    end_detail: list[str]
    """Cause of the end, in words; "" if unknown. Length n."""
    movement: NDArray[np.float64]
    """Movement in the first and last tenth of the test horizon, see `MovementRecorder`; shape (2, n)."""
    goals: NDArray[np.float64]
    """First step with a success (inf: none had one), most consecutive steps with one, and whether the last step had one
    (1 or 0), shape (3, n); nan where the environment does not say."""
    step_seconds: float = math.nan
    """Seconds of a control step; nan: unknown."""
    measures: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    """What the environment's last infos measure of an episode, by a name in `MEASURES`, shape (n,) each."""


def evaluate_episodes(
    policies: Sequence[PolicyLike],
    episodes: Sequence[EpisodeSpec],
    progress: Callable[[int, int], None] = lambda step, running: None,
    world: World | None = None,
    success: str | None = None,
) -> EpisodeRecords:
    """Run episodes that share their steps and disturbances, in this process, on one core.

    Args:
        policies: All for one task; `EpisodeSpec.policy` is an index into them.
        episodes: One or more.
        progress: Called every 500 steps with (step, running episodes).
        world: The world to run in, one lane for each of ``episodes``; it stays open. By default the policies' own task.
        success: See `Extrapolation`.

    Raises:
        PerdureError: If there is no episode or no step, an episode names a policy that there is not, episodes differ in
            their steps or disturbances, a policy does not fit its clock or the world, the world has another number of
            lanes, or the task's world cannot be built.
    """
    if not episodes:
        raise PerdureError("there is no episode to evaluate: give at least one EpisodeSpec")
    steps, disturbances = whole("steps", episodes[0].steps, 1), episodes[0].disturbances
    for episode in episodes:
        if not 0 <= episode.policy < len(policies):
            raise PerdureError(
                f"EpisodeSpec.policy must be an index into {len(policies)} policies, from 0, got {episode.policy}"
            )
    if any((episode.steps, episode.disturbances) != (steps, disturbances) for episode in episodes):
        raise PerdureError("episodes that run together must have the same steps and disturbances")
    acting = [EpisodePolicy(policies[episode.policy], episode.clock) for episode in episodes]
    seeds = [FIRST_EVAL_SEED + episode.eval_seed for episode in episodes]
    opened = make_world(disturbed_task(acting[0].policy.task.name, disturbances), seeds) if world is None else world
    try:
        report_success(opened, success)
        std = np.stack([each.policy.observation_std for each in acting])
        disturbed = DisturbedWorld(opened, disturbances, seeds, std) if disturbances else opened
        return _run(disturbed, acting, steps, progress)
    finally:
        if world is None:
            opened.close()


def _run(
    world: World, acting: Sequence[EpisodePolicy], steps: int, progress: Callable[[int, int], None]
) -> EpisodeRecords:
    loop = ClosedLoop(world, acting)
    recorder = _Recorder(loop, acting, steps, world.spec.hides_divergence)
    with one_thread():
        for step in range(1, steps + 1):
            recorder.take(step)
            if step % 500 == 0:
                progress(step, len(loop.running))
            if not len(loop.running):
                break
    infos = getattr(world, "infos", ())
    found = {name: [info.get(name) for info in infos] for name in MEASURES if any(name in info for info in infos)}
    measures = {
        name: np.array([value if isinstance(value, Real) and float(value) >= 0.0 else math.nan for value in values])
        for name, values in found.items()
    }
    return replace(recorder.records(), step_seconds=world.spec.step_seconds, measures=measures)


class _Recorder:
    """Accumulates the fields of EpisodeRecords while the loop runs."""

    def __init__(self, loop: ClosedLoop, acting: Sequence[EpisodePolicy], steps: int, hides_divergence: bool) -> None:
        n = len(acting)
        self._loop = loop
        self._steps = recorded_steps(steps)
        self._next = 0
        self._returns = np.zeros((n, len(self._steps)))
        self._total = np.zeros(n)
        self._end_step, self._reason = np.full(n, steps), np.full(n, SURVIVED)
        self._divergence = DivergenceDetector(
            loop.observations, np.stack([each.policy.observation_std for each in acting]), hides_divergence
        )
        self._movement = MovementRecorder([each.policy for each in acting], steps)
        self._goals = GoalRecorder(n)

    def take(self, step: int) -> None:
        """Advance the loop to step ``step`` and record the results."""
        loop_step = self._loop.advance()
        episodes, result = loop_step.episodes, loop_step.step
        rewards = result.rewards
        diverged = self._divergence.diverged(loop_step)
        if diverged.any():
            # The jump back to the start state yields a reward that does not count.
            rewards = np.where(diverged, 0.0, rewards)
            self._loop.drop(episodes[diverged])
        self._total[episodes] += rewards
        self._movement.take(loop_step, step)
        self._goals.take(episodes, result.successes, step)
        ended = result.ended | diverged
        if ended.any():
            self._end_step[episodes[ended]] = step
            reasons = np.where(diverged, DIVERGED, np.where(result.terminated, TERMINATED, TRUNCATED))
            self._reason[episodes[ended]] = reasons[ended]
        if step == self._steps[self._next]:
            self._returns[:, self._next] = self._total
            self._next += 1

    def records(self) -> EpisodeRecords:
        """Return the records; episodes that all ended early keep their values at the recorded steps not reached."""
        if self._next < len(self._steps):
            self._returns[:, self._next :] = self._total[:, None]
        return EpisodeRecords(
            steps=self._steps,
            returns=self._returns,
            end_step=self._end_step,
            end_reason=self._reason,
            end_detail=[self._detail(episode) for episode in range(len(self._total))],
            movement=self._movement.movement,
            goals=self._goals.found,
        )

    def _detail(self, episode: int) -> str:
        parts = [self._divergence.signs[episode]] if self._reason[episode] == DIVERGED else []
        if step := int(self._movement.left_step[episode]):
            component, names = self._movement.left_component[episode], self._loop.world.spec.observation_names
            name = f"observation[{component}]" + (f" ({names[component]})" if names else "")
            parts.append(f"{name} left its training range at step {step:,}")
        return "; ".join(parts)
