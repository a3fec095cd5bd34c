"""Episodes far beyond the training horizon: how they run, and what is recorded of them.

An episode is one deployed run: a policy under a clock from a start state, calm or disturbed. `Extrapolation` says which
ones there are (`perdure.evaluate.options`), `evaluate_episodes` runs them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perdure.disturbances import Disturbance, labels
from perdure.envs import FloatArray, World, make_world, report_success
from perdure.envs.disturbances import DisturbedWorld, disturbed_task
from perdure.errors import PerdureError
from perdure.horizon import Clock
from perdure.policy import ClosedLoop, DivergenceDetector, EpisodePolicy, LoopStep, PolicyLike
from perdure.policy.network import one_thread
from perdure.report.schema import MEASURES

FIRST_EVAL_SEED = 1_000_000
"""Evaluation seed k starts a world from seed FIRST_EVAL_SEED + k."""
CALM_STEPS = 100_000
"""Steps of calm episodes where none are asked for."""


def whole(name: str, value: Any, least: int) -> int:
    """Return a whole number, such as 1000 or 1e3, as an int; PerdureError if it is none, or less than `least`."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating) or value % 1 != 0:
        raise PerdureError(f"{name} must be a whole number, got {value!r}")
    if value < least:
        raise PerdureError(f"{name} must be at least {least}, got {value}")
    return int(value)


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


EVERY = 10
"""Steps between two measurements of movement, as events last much longer."""
SPAN = 10
"""Measurements until movement has a new origin."""
MARGIN = 0.5
"""A component has left its training range if it is outside by more than this share of the range."""


class MovementRecorder:
    """Mean movement in the first and the last tenth of the test horizon, and training ranges left.

    Movement: mean over components of |o_t - o_s| in training standard deviations, s being the start of each 100 steps.
    Over single steps it would depend on the control rate.
    """

    def __init__(self, policies: list[PolicyLike], steps: int) -> None:
        episodes = len(policies)
        size = policies[0].task.observation_size
        std = np.stack([policy.observation_std for policy in policies])
        self._per_deviation = np.where(std > 1e-6, 1.0 / np.maximum(std, 1e-6), 0.0)
        self._low = np.full((episodes, size), -np.inf)
        self._high = np.full((episodes, size), np.inf)
        for episode, policy in enumerate(policies):
            if policy.reference is not None:
                low = policy.reference.observation_low
                high = policy.reference.observation_high
                self._low[episode] = low - MARGIN * (high - low)
                self._high[episode] = high + MARGIN * (high - low)
        self._tenth = max(1, steps // 10)
        self._last_start = steps - self._tenth
        self._sums = np.zeros((2, episodes))
        self._counts = np.zeros((2, episodes))
        self._origin = np.zeros((episodes, size))
        self.left_step = np.zeros(episodes, np.int64)
        """Step at which a component was first seen outside; 0: never."""
        self.left_component = np.full(episodes, -1)

    def take(self, loop_step: LoopStep, step: int) -> None:
        """Record the episodes of this step, if it is a recording step."""
        if step % EVERY:
            return
        episodes = loop_step.episodes
        after = loop_step.step.observations
        part = None
        if step <= self._tenth:
            part = 0
        elif step > self._last_start:
            part = 1
        with np.errstate(invalid="ignore", over="ignore"):
            if part is not None:
                # Movement is measured from an origin that is renewed every SPAN measurements.
                renewed = self._counts[part, episodes] % SPAN == 0
                self._origin[episodes[renewed]] = loop_step.before[renewed]
                moved = (np.abs(after - self._origin[episodes]) * self._per_deviation[episodes]).mean(axis=1)
                known = np.isfinite(moved)
                self._sums[part, episodes[known]] += moved[known]
                self._counts[part, episodes[known]] += 1
            outside = (after < self._low[episodes]) | (after > self._high[episodes])
        # Of each episode the first component that left its training range is kept.
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
        self.found = np.full((3, episodes), np.nan)
        self._stay = np.zeros(episodes)
        self._said = False

    def take(self, episodes: NDArray[np.int64], successes: FloatArray | None, step: int) -> None:
        """Record a step of these episodes, see `Step.successes`. A step that does not say is no success."""
        if successes is None and not self._said:  # most tasks never say: nothing changes, and this is every step
            return
        self._said = True
        first, longest, _ = self.found[:, episodes]
        said = np.full(len(episodes), np.nan) if successes is None else successes
        known = ~np.isnan(said) | ~np.isnan(first)
        now = said == 1.0
        stay = np.where(now, self._stay[episodes] + 1.0, 0.0)
        self._stay[episodes] = stay
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
    steps = whole("steps", episodes[0].steps, 1)
    disturbances = episodes[0].disturbances
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
        self._end_step = np.full(n, steps)
        self._reason = np.full(n, SURVIVED)
        self._divergence = DivergenceDetector(
            loop.observations, np.stack([each.policy.observation_std for each in acting]), hides_divergence
        )
        self._movement = MovementRecorder([each.policy for each in acting], steps)
        self._goals = GoalRecorder(n)

    def take(self, step: int) -> None:
        """Advance the loop to step ``step`` and record the results."""
        loop_step = self._loop.advance()
        episodes = loop_step.episodes
        result = loop_step.step
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
        parts = []
        if self._reason[episode] == DIVERGED:
            parts.append(self._divergence.signs[episode])
        step = int(self._movement.left_step[episode])
        if step:
            component = self._movement.left_component[episode]
            names = self._loop.world.spec.observation_names
            name = f"observation[{component}]" + (f" ({names[component]})" if names else "")
            parts.append(f"{name} left its training range at step {step:,}")
        return "; ".join(parts)
