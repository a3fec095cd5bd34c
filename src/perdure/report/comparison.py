"""Is B better than A? Of the episodes of both in one table: paired differences, the decision, and who is best of many.

Two policies met the same start states and the same draws of the disturbances. Each start state is a pair, and the mean
difference B - A of one measure over the pairs decides, by an interval that stays valid while pairs are added
(`perdure.sequential`). Training runs of two methods have nothing in common: there the runs are the units.

| measure | of an episode | bounds |
|---|---|---|
| work | return above idle, as a share of what the better policy earns when calm (`perdure.report.work`) | 0 to 1.25 |
| holds | 1 if it holds or reaches its goal | 0 or 1 |
| hours | time before a failure, as a share of the episode | 0 to 1 |
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from perdure.errors import PerdureError
from perdure.report.groups import episode_verdicts, failure_times
from perdure.report.outcomes import WORKED, outcome_words
from perdure.report.work import episode_work
from perdure.sequential import betting_interval, pairs_until_decided
from perdure.stats import (
    CONFIDENCE,
    EVALUATION_SEEDS_ONLY,
    RESAMPLES,
    TRAINING_SEEDS,
    FailureRate,
    FloatArray,
    Interval,
    compare_unpaired,
    mean_interval,
    measure_failure_rate,
    permutation_p,
    runs_for_power,
    survival_interval,
)

if TYPE_CHECKING:
    import polars as pl

PolicyKey = tuple[str, int]
"""Label and training seed of a policy of a table."""
BETTER = "better"
WORSE = "worse"
CANNOT_TELL = "cannot tell"
START_STATES = "start state"
RUNS = "training run"
LEVEL = 1.0 - CONFIDENCE
SEED = 0
"""Seed of the bootstrap: the same table gives the same intervals."""
BETTING = "betting"
WELCH = "Welch t"
GARWOOD = "Garwood"


@dataclass(frozen=True)
class Measure:
    """What is compared of episodes."""

    words: str
    """Heading of its row."""
    span: float
    """Largest difference of two episodes."""


MEASURES = {
    "work": Measure("work", 1.25),
    "holds": Measure("share that holds", 1.0),
    "hours": Measure("time before a failure", 1.0),
}
"""Name, as `--by` takes it, to measure."""
FAILURES = "failures an hour"
"""Heading of the row that is shown only."""


# Episodes


def measured_episodes(frame: pl.DataFrame) -> pl.DataFrame:
    """Return one row for each episode of a judged table of one task, with a column for each of `MEASURES`.

    The unit of work is what the policy that earns most when calm would earn, the same for all policies. Below 0 and
    above 1.25, work counts as that. `failed`, `watched_steps` (after settling) and `step_seconds` give failures an
    hour.
    """
    import polars as pl

    last = frame.filter(pl.col("step") == pl.col("test_horizon")).with_columns(verdict=episode_verdicts())
    times, failed = failure_times(last["verdict"].to_list(), last["failed_step"].to_numpy())
    horizon = last["test_horizon"].to_numpy()
    ended = last["end_step"].to_numpy()
    work = _work(last)
    before = np.where(failed, np.minimum(times, horizon), horizon) / horizon
    good = last["verdict"].is_in(outcome_words(good=True)).cast(pl.Float64)
    watched = np.minimum(times, ended) - last["settling"].to_numpy()
    keys = ["policy", "train_seed", "disturbance", "eval_seed", "step_seconds"]
    return last.select(keys).with_columns(
        work=pl.Series(work),
        holds=good,
        hours=pl.Series(before),
        failed=pl.Series(failed),
        watched_steps=pl.Series(watched),
    )


def _work(last: pl.DataFrame) -> FloatArray:
    """Return the work of episodes in a common unit: the largest calm rate of a policy that worked, else of any."""
    import polars as pl

    worked = last.filter(pl.col("policy_state") == WORKED)
    if worked.is_empty():
        worked = last
    reference = float(worked["calm_rate"].to_numpy().max())
    earned = last["return"].to_numpy()
    work = episode_work(earned, last["end_step"], last["test_horizon"], last["idle_rate"], reference)
    return np.clip(work, 0.0, MEASURES["work"].span)


def _of_policy(episodes: pl.DataFrame, key: PolicyKey, condition: str) -> pl.DataFrame:
    """Return the episodes of one policy under one condition, in the order of their start states."""
    return episodes.filter(policy=key[0], train_seed=key[1], disturbance=condition).sort("eval_seed")


def _failure_rate(episodes: pl.DataFrame) -> FailureRate | None:
    """Return failures an hour after settling; None where the seconds of a step or the exposure are unknown."""
    seconds = float(episodes["step_seconds"][0])
    watched = episodes["watched_steps"].to_numpy()
    settled = watched > 0
    if not math.isfinite(seconds) or not settled.any():
        return None
    return measure_failure_rate(watched[settled], episodes["failed"].to_numpy()[settled], seconds / 3600.0)


# A summary: who is better, by how much, and everything beside it


@dataclass(frozen=True)
class Row:
    """One measure of A and B under one condition."""

    condition: str
    measure: str
    """One of `MEASURES`, or `FAILURES`."""
    a: Interval
    b: Interval
    difference: Interval
    """B - A."""

    @property
    def words(self) -> str:
        """Heading of the measure."""
        if self.measure in MEASURES:
            return MEASURES[self.measure].words
        return self.measure


@dataclass(frozen=True)
class Summary:
    """The answer to whether B is better than A."""

    task: str
    a: str
    b: str
    """Names of the two sides."""
    by: str
    """The measure that decides, of `MEASURES`."""
    condition: str
    """The condition under which it decides."""
    verdict: str
    """`BETTER` or `WORSE`: B is; else `CANNOT_TELL`."""
    more: float
    """About how many more start states, or runs a side, would decide, if they are like those seen; 0: decided."""
    counts: tuple[int, int]
    """Start states, or training runs, of each side."""
    rows: tuple[Row, ...]
    unit: str = START_STATES
    """Or `RUNS`."""
    notes: tuple[str, ...] = ()

    @property
    def deciding(self) -> Row:
        """The row that decides."""
        return next(each for each in self.rows if (each.condition, each.measure) == (self.condition, self.by))


def compare_policies(frame: pl.DataFrame, a: PolicyKey, b: PolicyKey, by: str) -> Summary:
    """Compare two policies of a judged table, over the start states that both met.

    Args:
        frame: Of one task. The last condition that it names decides; the start states of the others are fixed.
        a: One policy.
        b: The other.
        by: The measure that decides, of `MEASURES`.

    Raises:
        PerdureError: The measure is unknown in this task.
    """
    episodes = measured_episodes(frame)
    conditions = frame["disturbance"].unique(maintain_order=True).to_list()
    deciding = conditions[-1]
    rng = np.random.default_rng(SEED)
    rows: list[Row] = []
    for condition in conditions:
        left = _of_policy(episodes, a, condition)
        right = _of_policy(episodes, b, condition)
        assert left["eval_seed"].equals(right["eval_seed"])
        rows += _paired_rows(left, right, condition, condition == deciding, rng)
    differences = _differences(_of_policy(episodes, a, deciding), _of_policy(episodes, b, deciding), by)
    _check_known(frame, differences, by)
    row = next(each for each in rows if (each.condition, each.measure) == (deciding, by))
    verdict = _verdict(*row.difference.last())
    more = 0.0
    if verdict == CANNOT_TELL:
        more = pairs_until_decided(differences, MEASURES[by].span) - len(differences)
    counts = (len(differences), len(differences))
    left_name, right_name = _names([a, b])
    return Summary(
        task=frame["task"][0],
        a=left_name,
        b=right_name,
        by=by,
        condition=deciding,
        verdict=verdict,
        more=more,
        counts=counts,
        rows=tuple(rows),
        notes=_notes(frame),
    )


def _names(keys: Sequence[PolicyKey]) -> list[str]:
    """Return a name for each policy: its label, with the training seed where labels are the same."""
    labels = [label for label, _ in keys]
    names = []
    for label, seed in keys:
        if labels.count(label) > 1:
            label = f"{label}, training seed {seed}"
        names.append(label)
    return names


def _verdict(low: float, high: float) -> str:
    """Return the verdict on B of the bounds of B - A."""
    if low > 0.0:
        return BETTER
    if high < 0.0:
        return WORSE
    return CANNOT_TELL


def _check_known(frame: pl.DataFrame, differences: FloatArray, by: str) -> None:
    """Refuse a measure that says nothing in this task."""
    ends_at_goal = bool(frame["outcome"].is_in(outcome_words(by_goal=True)).any())
    why = ""
    if by == "work" and not np.isfinite(differences).all():
        why = "no policy here earns more than an idle robot"
    if by == "work" and ends_at_goal:
        why = "the task ends episodes at the goal"
    if why:
        raise PerdureError(f"work says nothing, because {why}: compare by another measure, --by holds or --by hours")


def _notes(frame: pl.DataFrame) -> tuple[str, ...]:
    """Return what limits a comparison."""
    import polars as pl

    policies = frame.select("policy", "train_seed", "policy_state").unique(maintain_order=True)
    failed = policies.filter(pl.col("policy_state") != WORKED)
    return tuple(f"{label}, training seed {seed}: {state} in training" for label, seed, state in failed.iter_rows())


def _differences(left: pl.DataFrame, right: pl.DataFrame, measure: str) -> FloatArray:
    differences: FloatArray = right[measure].to_numpy() - left[measure].to_numpy()
    return differences


def _paired_rows(
    left: pl.DataFrame, right: pl.DataFrame, condition: str, growing: bool, rng: np.random.Generator
) -> Iterator[Row]:
    """Yield the row of each measure of two policies.

    Args:
        left: Episodes of A.
        right: Those of B from the same start states.
        condition: Its label.
        growing: Whether start states are added until a decision: then intervals of differences are by betting.
        rng: For the bootstrap.
    """
    for name, measure in MEASURES.items():
        differences = _differences(left, right, name)
        found = mean_interval(differences, np.zeros(len(differences)), rng)
        if growing and np.isfinite(differences).all():
            low, high = betting_interval(differences, measure.span)
            found = replace(found, lower=np.array(low), upper=np.array(high), method=BETTING)
        a = _mean(left[name].to_numpy(), name, rng)
        b = _mean(right[name].to_numpy(), name, rng)
        yield Row(condition, name, a, b, found)
    rate_a = _failure_rate(left)
    rate_b = _failure_rate(right)
    if rate_a is not None and rate_b is not None:
        a = _rate_interval(rate_a, len(left))
        b = _rate_interval(rate_b, len(right))
        yield Row(condition, FAILURES, a, b, _rate_difference(left, right, rng))


def _mean(values: FloatArray, measure: str, rng: np.random.Generator) -> Interval:
    """Return the mean of one policy over start states."""
    if measure == "holds":
        return survival_interval(values, np.zeros(len(values)), rng)
    return mean_interval(values, np.zeros(len(values)), rng)


def _rate_interval(rate: FailureRate, count: int) -> Interval:
    bounds = (np.array(rate.per_hour), np.array(rate.lower), np.array(rate.upper))
    return Interval(*bounds, EVALUATION_SEEDS_ONLY, count, GARWOOD)


def _rate_difference(left: pl.DataFrame, right: pl.DataFrame, rng: np.random.Generator) -> Interval:
    """Return the difference of failures an hour, with a percentile bootstrap over start states; nan without a failure.

    Start states are drawn again, each with its episodes of both sides.
    """
    count = len(left)
    drawn = rng.multinomial(count, np.full(count, 1.0 / count), size=RESAMPLES).astype(np.float64)
    samples = np.concatenate([np.ones((1, count)), drawn])  # the first is what was seen
    rates = []
    for side in (left, right):
        watched = side["watched_steps"].to_numpy()
        settled = watched > 0
        hours = samples @ np.where(settled, watched, 0.0) * float(side["step_seconds"][0]) / 3600.0
        failures = samples @ (side["failed"].to_numpy() & settled).astype(np.float64)
        with np.errstate(divide="ignore", invalid="ignore"):
            rates.append(failures / hours)
    differences = rates[1] - rates[0]
    low = math.nan
    high = math.nan
    if np.isfinite(differences).all() and np.ptp(differences) > 0.0:
        low, high = np.quantile(differences[1:], [LEVEL / 2.0, 1.0 - LEVEL / 2.0])
    return Interval(np.array(differences[0]), np.array(low), np.array(high), EVALUATION_SEEDS_ONLY, count)


# Two methods, several training runs of each


def compare_methods(
    frame: pl.DataFrame, a: Sequence[PolicyKey], b: Sequence[PolicyKey], by: str, names: tuple[str, str]
) -> Summary:
    """Compare the training runs of two methods; a run's value is the mean over its episodes.

    It is decided if a permutation test over runs at 5 % and Welch's interval agree.

    Args:
        frame: Of one task. The last condition that it names decides.
        a: The runs of one method.
        b: Those of the other.
        by: The measure that decides, of `MEASURES`.
        names: Of the two methods.

    Raises:
        PerdureError: The measure is unknown in this task.
    """
    episodes = measured_episodes(frame)
    conditions = frame["disturbance"].unique(maintain_order=True).to_list()
    deciding = conditions[-1]
    rows = []
    for condition in conditions:
        for name in (*MEASURES, FAILURES):
            left = _run_values(episodes, a, condition, name)
            right = _run_values(episodes, b, condition, name)
            if name in MEASURES or np.isfinite([*left, *right]).all():
                rows.append(_row_of_runs(condition, name, left, right))
    left = _run_values(episodes, a, deciding, by)
    right = _run_values(episodes, b, deciding, by)
    _check_known(frame, np.concatenate([left, right]), by)
    p = permutation_p(left, right)
    verdict = CANNOT_TELL
    more = 0.0
    if p <= LEVEL:
        row = next(each for each in rows if (each.condition, each.measure) == (deciding, by))
        verdict = _verdict(*row.difference.last())
    if verdict == CANNOT_TELL:
        more = max(1.0, runs_for_power(left, right) - min(len(left), len(right)))
    return Summary(
        task=frame["task"][0],
        a=names[0],
        b=names[1],
        by=by,
        condition=deciding,
        verdict=verdict,
        more=more,
        counts=(len(left), len(right)),
        rows=tuple(rows),
        unit=RUNS,
        notes=(f"permutation test over training runs: p = {p:.2g}", *_notes(frame)),
    )


def _run_values(episodes: pl.DataFrame, runs: Sequence[PolicyKey], condition: str, name: str) -> FloatArray:
    """Return a value for each training run; nan where its failures an hour are unknown."""
    values = []
    for run in runs:
        mine = _of_policy(episodes, run, condition)
        if name in MEASURES:
            values.append(float(mine[name].to_numpy().mean()))
        else:
            rate = _failure_rate(mine)
            values.append(math.nan if rate is None else rate.per_hour)
    return np.array(values)


def _row_of_runs(condition: str, name: str, left: FloatArray, right: FloatArray) -> Row:
    rng = np.random.default_rng(SEED)
    a = mean_interval(left, np.zeros(len(left)), rng)
    b = mean_interval(right, np.zeros(len(right)), rng)
    found = compare_unpaired(right, left)
    numbers = (np.array(found.estimate), np.array(found.lower), np.array(found.upper))
    difference = Interval(*numbers, TRAINING_SEEDS, found.count, WELCH)
    if name in MEASURES:
        most = MEASURES[name].span
        a = a.within(0.0, most)
        b = b.within(0.0, most)
        difference = difference.within(-most, most)
    return Row(condition, name, replace(a, label=TRAINING_SEEDS), replace(b, label=TRAINING_SEEDS), difference)


# The best of many


@dataclass(frozen=True)
class Ranked:
    """A policy of a ranking."""

    name: str
    value: Interval
    """Mean of the measure that decides, over the start states of the ranking."""
    share: Interval
    """Share of the episodes that hold."""


@dataclass(frozen=True)
class Ranking:
    """Policies by one measure, the best first, and the best one confirmed on start states that did not select it."""

    task: str
    by: str
    condition: str
    seeds: int
    """Start states of the ranking."""
    policies: tuple[Ranked, ...]
    confirmed: Summary
    """The winner (B) against the second (A), on fresh start states."""

    @property
    def winner(self) -> Ranked:
        """The first."""
        return self.policies[0]


def rank_policies(
    frame: pl.DataFrame, keys: Sequence[PolicyKey], by: str
) -> tuple[list[PolicyKey], tuple[Ranked, ...]]:
    """Rank policies of a judged table by their mean under its last condition; ties keep the given order.

    Returns:
        (the policies, the best first; the same with their numbers).

    Raises:
        PerdureError: The measure is unknown in this task.
    """
    episodes = measured_episodes(frame)
    condition = frame["disturbance"].to_list()[-1]
    rng = np.random.default_rng(SEED)
    names = dict(zip(keys, _names(keys), strict=True))
    found: dict[PolicyKey, Ranked] = {}
    for key in keys:
        mine = _of_policy(episodes, key, condition)
        values = mine[by].to_numpy()
        _check_known(frame, values, by)
        found[key] = Ranked(names[key], _mean(values, by, rng), _mean(mine["holds"].to_numpy(), "holds", rng))
    order = sorted(keys, key=lambda key: -float(found[key].value.estimate))
    return order, tuple(found[key] for key in order)


# As a frame and as JSON


def measures_frame(summary: Summary) -> pl.DataFrame:
    """Return one row for each condition and measure, with the bounds of A, B and B - A."""
    import polars as pl

    rows = []
    for each in summary.rows:
        row: dict[str, Any] = {"condition": each.condition, "measure": each.words}
        for name, interval in (("a", each.a), ("b", each.b), ("difference", each.difference)):
            row |= {f"{name}_{part}": value for part, value in bounds(interval).items()}
        rows.append(row | {"interval": each.difference.method})
    return pl.DataFrame(rows)


def bounds(interval: Interval) -> dict[str, float]:
    """Return estimate, low and high."""
    low, high = interval.last()
    return {"estimate": float(interval.estimate), "low": low, "high": high}
