"""Groups: the episodes of a table that share task, policy, clock and disturbance; a curve, a row or a dot shows one.

Each episode has an outcome in the table; a group adds what is known of its episodes together: when they fail, how many
failures there are per hour, and whether its start states behave as one.

Episodes that end at the goal have their own verdicts. Elsewhere successes count as in ManiSkill-HAB: whether there was
one, whether the last step is one, and the longest stay.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from perdure.disturbances import CALM
from perdure.horizon import Clock
from perdure.report import wording
from perdure.report.outcomes import (
    WORKED,
    CannotTell,
    Cut,
    MissesGoal,
    NeverWorked,
    ReachesGoal,
    Unknown,
    failures,
    outcome_words,
    outcomes,
)
from perdure.report.schema import GOALS, MEASURES, Episodes, IntArray, table_episodes
from perdure.report.scores import FEWEST_JUDGED, HOLDS_FROM
from perdure.stats import BoolArray, FailureRate, FloatArray, kaplan_meier, measure_failure_rate, median_time

WALKS = (
    *("turns {} degrees a minute from its commanded heading", "drifts {} m a minute from its commanded path"),
    *("misses its commanded velocity by {} m/s", "its motors work {} J/m"),
)
SUCCESSES = [
    pl.when(pl.col(name).is_nan().all().over("task")).then(name).otherwise(pl.col(name).fill_nan(none)).alias(name)
    for name, none in GOALS.items()
]
"""If the environment reports successes in some episodes, those of which it says nothing have none."""
NO_CLOCK = "none"
MOSTLY_FALLS = 0.5
"""A policy mostly falls in training if more than this share of its reference episodes do."""
ALIKE = 0.01
"""Start states behave as one if the rewards of a window differ by less than this share of the gain over idle."""
MARKS = 100
"""Most windows in which rewards are compared."""
ALL = pl.lit(True)
TRAINING_SCORE = (pl.col("training_rate") - pl.col("idle_rate")) / (pl.col("published_rate") - pl.col("idle_rate"))
"""Score of a policy within its training horizon against a published policy of the task; nan: none is known."""


def episode_verdicts() -> pl.Expr:
    """Return the outcome of each episode of a table as reports show it, such as "never worked".

    A task that ends episodes at the goal judges no rewards. In others the state of the policy in training comes first,
    but an end that the task decided counts for a policy of which nothing can be told.
    """
    outcome = pl.col("outcome")
    state = pl.col("policy_state")
    ended = outcome.is_in(outcome_words(by_end=True))
    task_has_goal = (outcome == ReachesGoal.name).any().over("task")
    shown = {each.name: each.shown_as or each.name for each in outcomes(in_table=True)}
    return (
        pl.when(task_has_goal & ~ended)
        .then(pl.lit(MissesGoal.name))
        .when(~task_has_goal & (state != WORKED) & ~((state == CannotTell.name) & ended))
        .then(state)
        .otherwise(outcome.replace(shown))
    )


def _notes() -> pl.Expr:
    """Return why an episode has no outcome: the evidence for the state of its policy, or what cut it short; else ""."""
    cut = pl.col("outcome") == Cut.name
    unknown = pl.col("outcome") == Unknown.name
    state = pl.col("policy_state")
    end = pl.col("end_step")
    cut_at_one_step = cut & (state != NeverWorked.name) & (end.filter(cut).min() == end.max())
    # With so many steps an episode is judged in any case; one window is for rounding.
    enough = pl.col("settling") + (FEWEST_JUDGED + 1) * pl.col("window")
    return (
        pl.when(cut_at_one_step)
        .then(pl.format("the environment truncates episodes at step {}: remove its counter", "end_step"))
        .when(state != WORKED)
        .then(pl.col("policy_note"))
        .when(cut)
        .then(pl.lit("the environment ended the episodes, for a reason that is no failure"))
        .when(unknown & (pl.col("test_horizon") < enough))
        .then(pl.format("too few steps to tell: at least {} are needed", enough))
        .when(unknown)
        .then(pl.lit(f"a final score too close to {100 * HOLDS_FROM:.0f} % to tell"))
        .otherwise(pl.lit(""))
    )


@dataclass(frozen=True)
class Group:
    """Episodes that share task, line and clock."""

    task: str
    policies: str
    """Name of the policies: the method, its training seeds pooled; the policy's label if that would mix policies."""
    line: str
    """Name of the policies, and what disturbs the episodes."""
    clock: str
    clock_kind: str
    clock_steps: float
    disturbance: str
    train_horizon: float
    """[steps]; inf: trained without an end; nan: unknown."""
    test_horizon: int
    steps: IntArray
    """Recorded steps, shape (steps,), rising."""
    facts: pl.DataFrame
    """One row for each episode: the table's columns, `verdict`, `note` and `training_score` (see `episode_verdicts`,
    `_notes` and `TRAINING_SCORE`; the score is nan for a policy that mostly falls in training, whose rate lasts for a
    moment)."""
    runs: IntArray
    """Which training run each episode belongs to, shape (episodes,)."""
    returns: FloatArray
    """Shape (episodes, steps)."""
    alive: BoolArray
    """Shape (episodes, steps)."""

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.facts[name].to_numpy()

    @property
    def episodes(self) -> int:
        """Number of episodes."""
        return len(self.runs)

    @property
    def verdicts(self) -> list[str]:
        """Outcome of each episode; "never worked" or "cannot tell" if its policy was that in training."""
        return self.facts["verdict"].to_list()

    @property
    def calm(self) -> bool:
        """Whether nothing disturbs the episodes."""
        return self.disturbance == CALM

    @property
    def condition(self) -> str:
        """What disturbs the episodes, and what of it the world could not do."""
        left_out = "" if self.calm else self["not_applied"][0]
        return f"{self.disturbance} without {left_out}" if left_out else self.disturbance

    @property
    def label(self) -> str:
        """Label for readers, e.g. "geometric, always 500 steps to go"."""
        return self._with_clock(self.line)

    @property
    def policy_and_clock(self) -> str:
        """The label without what disturbs the episodes."""
        return self._with_clock(self.policies)

    def _with_clock(self, name: str) -> str:
        return name if self.clock_kind == NO_CLOCK else f"{name}, {self.clock_words}"

    @property
    def clock_words(self) -> str:
        """The clock for readers, e.g. "always 500 steps to go"."""
        known = np.isfinite(self.clock_steps)
        return wording.clock(self.clock_kind, wording.whole(self.clock_steps)) if known else self.clock

    @property
    def clock_flag(self) -> str:
        """The clock as `--clocks` takes it, e.g. "constant:500"."""
        return self.clock.replace("(", ":").rstrip(")")

    @property
    def is_tuned_by_steps(self) -> bool:
        """Whether the clock has a parameter C."""
        kind = Clock.kinds().get(self.clock_kind, Clock)
        return self.clock_kind != NO_CLOCK and kind.is_tuned and bool(np.isfinite(self.clock_steps))

    @property
    def falls_in_training(self) -> bool:
        """Whether most reference episodes fell within the training horizon."""
        return bool(np.nanmean(known) > MOSTLY_FALLS) if np.isfinite(known := self["training_falls"]).any() else False

    @property
    def one_end(self) -> int | None:
        """The step at which all of eight or more episodes terminate; None for contracts, which have no time limit."""
        terminated = self["end_reason"] == "terminated"
        ends = np.unique(self["end_step"])
        found = terminated.all() and len(ends) == 1 and self.episodes >= 8 and not medians(self)
        return int(ends[0]) if found else None

    @cached_property
    def failed(self) -> BoolArray:
        """Which episodes fell, diverged, decayed or failed silently, shape (episodes,)."""
        return np.isin(self.verdicts, failures())

    @cached_property
    def working(self) -> FloatArray:
        """Share of episodes without a failure so far at each recorded step (Kaplan-Meier), shape (steps,).

        An episode that the environment cut, or that cannot be judged, is watched until it ended.
        """
        times, shares = kaplan_meier(*failure_times(self.verdicts, self["failed_step"]))
        return np.concatenate([[1.0], shares])[np.searchsorted(times, self.steps, side="right")]

    @property
    def half_failed_by(self) -> float:
        """Steps by which half of the episodes have failed, see `half_failed_by`."""
        return half_failed_by(self.verdicts, self["failed_step"])

    @cached_property
    def failure_rate(self) -> FailureRate | None:
        """Failures per hour of disturbed episodes after settling; None without a step's seconds or if one never worked.

        Calm episodes have none: they hardly differ, so they are no independent exposure.
        """
        times, failed = failure_times(self.verdicts, self["failed_step"])
        times = np.minimum(times, self["end_step"]) - self["settling"]
        hours = float(self["step_seconds"][0]) / 3600.0
        settled = times > 0
        if self.calm or not np.isfinite(hours) or not settled.any() or NeverWorked.name in self.verdicts:
            return None
        return measure_failure_rate(times[settled], failed[settled], hours)

    @cached_property
    def runs_alike(self) -> int:
        """Number of training runs whose calm start states behave as one, see `behave_as_one`."""
        gain = self["training_rate"] - self["idle_rate"]
        settling = self["settling"]
        parts = [
            self.runs == run for run in np.unique(self.runs) if self.calm and self.alive[self.runs == run, -1].all()
        ]
        return sum(behave_as_one(self.steps, self.returns[mine], settling[mine][0], gain[mine][0]) for mine in parts)

    @cached_property
    def final_score(self) -> FloatArray:
        """Score against its own training at the end; 0 for ended episodes, nan where it is unknown; shape (episodes,).

        An episode that fell before its first whole window counts as 0. A policy that cannot be judged has no score, and
        an episode that the environment cut or that ended at its goal has none.
        """
        ended = ~self.alive[:, -1] & ~np.isin(self.verdicts, [ReachesGoal.name])
        score = np.where(np.isin(self.verdicts, [CannotTell.name]), np.nan, 0.0)
        return np.where(ended & (self["policy_state"] == WORKED), score, self["end_score_vs_training"])

    def paired(self, other: Group) -> tuple[list[int], list[int]]:
        """Return the episodes of both groups that have the same policy and start state, in one order."""
        mine, its = (
            list(group.facts.select("policy", "train_seed", "eval_seed").iter_rows()) for group in (self, other)
        )
        place = {key: episode for episode, key in enumerate(its)}
        pairs = [(episode, place[key]) for episode, key in enumerate(mine) if key in place]
        return [episode for episode, _ in pairs], [episode for _, episode in pairs]


def failure_times(verdicts: Sequence[str], failed_step: IntArray) -> tuple[IntArray, BoolArray]:
    """Return the steps until each episode failed or was no longer watched, and which failed: for `kaplan_meier`.

    Policies that never worked have failed from the start. What has reached or missed its goal does not fail.
    """
    never = np.isin(verdicts, [NeverWorked.name])
    judged_by_goal = np.isin(verdicts, outcome_words(by_goal=True))
    times = np.where(judged_by_goal, np.iinfo(np.int64).max, np.where(never, 0, failed_step))
    return times, np.isin(verdicts, failures()) | never


def half_failed_by(verdicts: Sequence[str], failed_step: IntArray) -> float:
    """Return the median of the Kaplan-Meier curve [steps]; nan where less than half of the episodes failed."""
    return median_time(*failure_times(verdicts, failed_step))


def behave_as_one(steps: IntArray, returns: FloatArray, settling: int, gain: float) -> bool:
    """Return whether episodes from several start states earn the same in every window after settling.

    Args:
        steps: Recorded steps, rising, shape (m,).
        returns: Sum of rewards up to each, of episodes that did not end, shape (episodes, m).
        settling: Steps at the start that are left out.
        gain: Reward per step of the policy in training above that of an idle robot.
    """
    wanted = np.linspace(min(settling, steps[-1]), steps[-1], MARKS + 1)
    marks = np.unique(np.searchsorted(steps, wanted))
    if len(returns) < 2 or len(marks) < 2:
        return False
    rates = np.diff(returns[:, marks], axis=1) / np.diff(steps[marks])
    return bool(np.sqrt(((rates - rates.mean(axis=0)) ** 2).mean()) < ALIKE * gain)


def make_groups(table: pl.DataFrame | Sequence[Episodes], mine: pl.Expr = ALL) -> tuple[Group, ...]:
    """Split an extrapolation table, or its episodes, into groups; PerdureError if the table does not fit the schema.

    Tasks and lines keep the order in which the table names them; within a line the clocks are sorted: none, then by
    `Clock.place`, each kind by its number of steps. Groups hold the episodes that `mine` selects; whether a task ends
    at its goal is seen in the whole table.
    """
    tasks = table_episodes(table, "The table") if isinstance(table, pl.DataFrame) else table
    whole = pl.concat([task.facts for task in tasks]).with_columns(SUCCESSES, verdict=episode_verdicts())
    groups = []
    for task, facts in zip(tasks, whole.partition_by("task", "disturbance", maintain_order=True), strict=True):
        score = (
            pl.when(pl.col("training_falls").fill_nan(0.0) <= MOSTLY_FALLS).then(TRAINING_SCORE).otherwise(float("nan"))
        )
        facts = facts.with_row_index("row").filter(mine).with_columns(note=_notes(), training_score=score)
        facts = _name_lines(facts).sort("policy", "train_seed", "eval_seed")
        order = {line: index for index, line in enumerate(facts.sort("place")["line"].unique(maintain_order=True))}
        parts = [_make_group(task, part) for part in facts.partition_by("line", "clock")]
        groups += sorted(parts, key=lambda group: (order[group.line], *_clock_order(group)))
    return tuple(groups)


def _name_lines(facts: pl.DataFrame) -> pl.DataFrame:
    """Add the columns `policies` and `line`."""
    horizon = pl.col("train_horizon")
    whole = horizon.is_finite()
    number = pl.when(whole).then(horizon).otherwise(0.0).cast(pl.Int64).cast(pl.String)
    shown = pl.when(whole).then(number).when(horizon.is_nan()).then(pl.lit("?")).otherwise(pl.lit("\u221e"))
    pooled = pl.col("policy").n_unique().over("method", "train_horizon") == 1
    ambiguous = horizon.n_unique().over("method") > 1
    method = pl.col("method") + pl.when(ambiguous).then(pl.format(" (T = {})", shown)).otherwise(pl.lit(""))
    facts = facts.with_columns(policies=pl.when(pooled).then(method).otherwise("policy"))
    disturbed = pl.format("{} under {}", "policies", "disturbance")
    return facts.with_columns(line=pl.when(pl.col("disturbance") == CALM).then("policies").otherwise(disturbed))


def _clock_order(group: Group) -> tuple[int, str, float, str]:
    kind = group.clock_kind
    place = 0
    if kind != NO_CLOCK:
        place = Clock.kinds().get(kind, Clock).place
    return place, kind, np.nan_to_num(group.clock_steps, nan=-1.0), group.clock


_OF_GROUP = (
    *("task", "policies", "line", "clock", "clock_kind", "clock_steps", "disturbance", "train_horizon"),
    "test_horizon",
)


def _make_group(episodes: Episodes, part: pl.DataFrame) -> Group:
    rows = part["row"].to_numpy()
    runs = part.select(pl.struct("policy", "train_seed").rank("dense")).to_series().cast(pl.Int64).to_numpy()
    return Group(
        **part.select(_OF_GROUP).row(0, named=True),
        steps=episodes.steps,
        facts=part.drop("row", "place"),
        runs=runs,
        returns=episodes.returns[rows],
        alive=episodes.alive[rows],
    )


# Tasks with a goal: how often, when and how long episodes are at it. Measures of a robot's walk: is it straight?


def success_cells(group: Group) -> dict[str, str]:
    """Return what a table shows of a group, by heading; {} where the environment reports no successes."""
    first, stay, at_end = (group[name] for name in GOALS)
    if np.isnan(first).any():
        return {}
    once, end = (wording.share(float(each.mean())) for each in (np.isfinite(first), at_end))
    return {"success once": once, "success at end": end, "longest stay": wording.whole(float(np.median(stay)))}


def reaching(group: Group) -> str:
    """Return "reaches its goal in 18 of 20 episodes, after 43 steps (median, 1.72 s)"."""
    reaches = ReachesGoal.name
    return f"{reaches} in {_counted(group, group.verdicts.count(reaches))}"


def goal_evidence(group: Group, label: str) -> Iterator[str]:
    """Yield what is to be said of the goal beside the verdict."""
    first, stay, at_end = (group[name] for name in GOALS)
    if label == ReachesGoal.name:
        return
    if (step := group.one_end) is not None:
        yield f"every episode ends at step {step:,}: the environment may report its time limit as a termination"
    if {*outcome_words(by_goal=True)} & {*group.verdicts}:
        yield reaching(group)
    elif not np.isnan(first).any():
        once = int(np.isfinite(first).sum())
        yield f"success once in {_counted(group, once)}" + (f", at the end in {at_end.sum():.0f}" if once else "")
        if once:
            middle, kept = np.quantile(stay, (0.5, 0.1), method="lower")
            yield f"longest stay {middle:,.0f} steps (median), {kept:,.0f} or more in nine of ten"


def _counted(group: Group, number: int) -> str:
    """Return how many episodes these are, and after how many steps an episode has its first success."""
    counted = f"{number} of {wording.count(group.episodes, 'episode')}"
    steps = group["goal_first_step"]
    if not np.isfinite(steps).any():
        return counted
    middle = np.median(steps[np.isfinite(steps)])
    seconds = "" if np.isnan(step := group["step_seconds"][0]) else f", {middle * step:.3g} s"
    return f"{counted}, after {middle:,.0f} steps (median{seconds})"


def medians(group: Group) -> dict[str, float]:
    """Return the median of each of `MEASURES` over the episodes that have it, by name."""
    known = {name: group[name][np.isfinite(group[name])] for name in MEASURES}
    return {name: float(np.median(values)) for name, values in known.items() if len(values)}


def walk_evidence(group: Group) -> Iterator[str]:
    """Yield what is to be said of the walk beside the verdict."""
    words = dict(zip(MEASURES, WALKS, strict=True))
    for name, value in medians(group).items():
        yield words[name].format(wording.quantity(value))
