"""What a table says: groups of episodes with estimates, the verdict on each, and which clock of a policy is best.

A group is the episodes that share task, policy and clock; a curve, a row or a dot shows one. Each episode has an
outcome in the table. The verdict on a group is *holds* if at least HOLDING_SHARE of its episodes hold, otherwise the
most common other outcome. Clocks of one policy are compared by paired differences on common start states.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby, takewhile
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from perdure.report import wording
from perdure.report.schema import CALM, Episodes, IntArray, table_episodes
from perdure.stats import (
    BoolArray,
    FloatArray,
    Interval,
    estimate_interval,
    kaplan_meier,
    make_units,
    mean_interval,
    median_time,
    survival_interval,
)

SEED = 0
"""Seed of the bootstrap: the same table gives the same intervals."""
MOST_POINTS = 80
"""Recorded steps drawn per curve; a table may hold many more."""
HOLDING_SHARE = 0.9
"""Share of its episodes that must hold for a policy to hold."""
MOTIONLESS = 0.02
"""Movement per step, in training standard deviations, below which a robot is called nearly motionless."""
MUCH = 2.0
"""Movement counts as changed if its ratio, last to first tenth of the steps, exceeds MUCH or is below 1 / MUCH."""
EPISODE_FAILURES = ("falls", "fails silently", "decays", "diverges")
FAILURES = (*EPISODE_FAILURES, "never worked", "cannot tell")
"""Verdicts other than "holds"; of two equally common ones, the earlier is taken."""
NO_CLOCK = "none"
FACTORS = ("mass", "friction", "strength")
"""Disturbances whose level 1 changes nothing; that of the others is 0."""
ROUNDING = 1e-9
"""Shares that differ by less are equal."""
_KIND_ORDER = (NO_CLOCK, "countdown", "constant", "periodic")
_MOST_NAMED, _MOST_CLOCKS, _MOST_LISTED = 6, 6, 20
"""Most policies in a headline, clocks in a sentence, and training runs whose seeds are listed."""

VERDICT = (
    pl.when(pl.col("policy_state") != "worked")
    .then(pl.col("policy_state"))
    .when(pl.col("outcome").is_in(["cut", "unknown"]))
    .then(pl.lit("cannot tell"))
    .otherwise(pl.col("outcome"))
)
"""Outcome of an episode as reports show it, from the columns of a table."""
_NOTE = (
    pl.when(pl.col("policy_state") != "worked")
    .then(pl.col("policy_note"))
    .when(pl.col("outcome") == "cut")
    .then(pl.lit("the environment ended the episodes, for a reason that is no failure"))
    .when(pl.col("outcome") == "unknown")
    .then(pl.lit("too few steps, or a final score too close to 75 % to tell"))
    .otherwise(pl.lit(""))
)
"""Why an episode has no outcome: the evidence for the state of its policy, or what cut it short; else ""."""
TRAINING_SCORE = (pl.col("training_rate") - pl.col("idle_rate")) / (pl.col("published_rate") - pl.col("idle_rate"))
"""Score of a policy within its training horizon against a published policy of the task; nan: none is known."""


# Groups


@dataclass(frozen=True)
class Group:
    """Episodes that share task, line and clock."""

    task: str
    line: str
    """Name of the policies: the method, its training seeds pooled; the policy's label if that would mix policies."""
    clock: str
    clock_kind: str
    clock_steps: float
    train_horizon: float
    """[steps]; inf: trained without an end; nan: unknown."""
    test_horizon: int
    steps: IntArray
    """Recorded steps, shape (steps,), rising."""
    facts: pl.DataFrame
    """One row for each episode: the table's columns, `verdict`, `note` and `training_score` (see `VERDICT`,
    `_NOTE` and `TRAINING_SCORE`)."""
    runs: IntArray
    """Which training run each episode belongs to, shape (episodes,)."""
    returns: FloatArray
    """Shape (episodes, steps)."""
    alive: BoolArray
    """Shape (episodes, steps)."""

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return a column of `facts`, shape (episodes,)."""
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
    def label(self) -> str:
        """Label for readers, e.g. "geometric, always 500 steps to go"."""
        return self.line if self.clock_kind == NO_CLOCK else f"{self.line}, {self.clock_words}"

    @property
    def clock_words(self) -> str:
        """The clock for readers, e.g. "always 500 steps to go"."""
        known = np.isfinite(self.clock_steps)
        return wording.clock(self.clock_kind, wording.whole(self.clock_steps)) if known else self.clock

    @property
    def is_tuned_by_steps(self) -> bool:
        """Whether the clock has a parameter C."""
        return self.clock_kind in ("constant", "periodic")

    @property
    def only_survival(self) -> bool:
        """Whether every step pays the same, to an idle robot too: there is no gain, only how long an episode lasts."""
        return bool((self["training_rate"] == self["idle_rate"]).all())

    @cached_property
    def failed(self) -> BoolArray:
        """Which episodes fell, diverged, decayed or failed silently, shape (episodes,)."""
        return np.isin(self.verdicts, EPISODE_FAILURES)

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
    def final_score(self) -> FloatArray:
        """Score against its own training at the end; 0 for ended episodes, nan where it is unknown; shape (episodes,).

        An episode that fell before its first whole window counts as 0.
        """
        ended, score = ~self.alive[:, -1], self.facts["end_score_vs_training"].to_numpy()
        return np.where(ended & (self.failed | np.isfinite(score)), 0.0, score)

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

    Policies that never worked have failed from the start.
    """
    never = np.isin(verdicts, ["never worked"])
    return np.where(never, 0, failed_step), np.isin(verdicts, EPISODE_FAILURES) | never


def half_failed_by(verdicts: Sequence[str], failed_step: IntArray) -> float:
    """Return the median of the Kaplan-Meier curve [steps]; nan where less than half of the episodes failed."""
    return median_time(*failure_times(verdicts, failed_step))


def make_groups(table: pl.DataFrame | Sequence[Episodes]) -> tuple[Group, ...]:
    """Split an extrapolation table, or its episodes, into groups; PerdureError if the table does not fit the schema.

    Tasks and lines keep the order in which the table names them; within a line the clocks are sorted: none, countdown,
    constant, periodic, each by its number of steps.
    """
    tasks = table_episodes(table, "The table") if isinstance(table, pl.DataFrame) else table
    groups = []
    for task in tasks:
        facts = task.facts.with_row_index("row").with_columns(
            verdict=VERDICT, note=_NOTE, training_score=TRAINING_SCORE
        )
        facts = _name_lines(facts).sort("policy", "train_seed", "eval_seed")
        order = {line: index for index, line in enumerate(facts.sort("place")["line"].unique(maintain_order=True))}
        mine = [_make_group(task, part) for part in facts.partition_by("line", "clock")]
        groups += sorted(mine, key=lambda group: (order[group.line], *_clock_order(group)))
    return tuple(groups)


def _name_lines(facts: pl.DataFrame) -> pl.DataFrame:
    """Add the column `line`."""
    horizon = pl.col("train_horizon")
    whole = horizon.is_finite()
    number = pl.when(whole).then(horizon).otherwise(0.0).cast(pl.Int64).cast(pl.String)
    shown = pl.when(whole).then(number).when(horizon.is_nan()).then(pl.lit("?")).otherwise(pl.lit("\u221e"))
    pooled = pl.col("policy").n_unique().over("method", "train_horizon") == 1
    ambiguous = horizon.n_unique().over("method") > 1
    method = pl.col("method") + pl.when(ambiguous).then(pl.format(" (T = {})", shown)).otherwise(pl.lit(""))
    facts = facts.with_columns(line=pl.when(pooled).then(method).otherwise("policy"))
    disturbed = pl.format("{} under {}", "line", "disturbance")
    return facts.with_columns(line=pl.when(pl.col("disturbance") == CALM).then("line").otherwise(disturbed))


def _clock_order(group: Group) -> tuple[int, str, float, str]:
    kind = group.clock_kind
    place = _KIND_ORDER.index(kind) if kind in _KIND_ORDER else len(_KIND_ORDER)
    return place, kind, np.nan_to_num(group.clock_steps, nan=-1.0), group.clock


_OF_GROUP = ("task", "line", "clock", "clock_kind", "clock_steps", "train_horizon", "test_horizon")


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


# Estimates


@dataclass(frozen=True)
class Estimate:
    """A group with its means and intervals."""

    group: Group
    steps: IntArray
    """The recorded steps kept, shape (points,); the last one is the table's last."""
    returns: Interval
    """Mean cumulative return, shape (points,)."""
    return_units: FloatArray
    """Of the units of these intervals, shape (units, points)."""
    survival: Interval
    """Share of episodes alive, shape (points,)."""
    working: Interval
    """Share of episodes without a failure so far (Kaplan-Meier), shape (points,); no bounds once an episode is cut."""
    final_score: Interval
    """Score against its own training at the end, ended episodes count 0; shape ()."""
    verdict: Verdict

    @property
    def final_return(self) -> float:
        """Mean return at the last recorded step."""
        return float(self.returns.estimate[-1])


Estimates = dict[str, list[Estimate]]
"""Every group's estimates by task, in the table's order."""


def estimate_table(table: pl.DataFrame | Sequence[Episodes]) -> Estimates:
    """Estimate every group of a table, or of its episodes; PerdureError if the table does not fit the schema."""
    rng, found = np.random.default_rng(SEED), Estimates()
    for group in make_groups(table):
        found.setdefault(group.task, []).append(estimate_group(group, rng))
    return found


def estimate_group(group: Group, rng: np.random.Generator) -> Estimate:
    """Estimate a group: episodes averaged within training runs, intervals over runs (see `perdure.stats`)."""
    kept = thin(group.steps, MOST_POINTS)
    known = np.isfinite(group.final_score)
    rows = known if known.any() else np.ones_like(known)
    units = make_units(group.returns[:, kept], group.runs)
    return Estimate(
        group=group,
        steps=group.steps[kept],
        returns=estimate_interval(units, rng),
        return_units=units.values,
        survival=survival_interval(group.alive[:, kept], group.runs, rng),
        working=_working(group, kept, rng),
        final_score=mean_interval(group.final_score[rows], group.runs[rows], rng),
        verdict=judge(group, rng),
    )


def _working(group: Group, kept: IntArray, rng: np.random.Generator) -> Interval:
    """Return the Kaplan-Meier curve over all episodes; the interval is that of the share of failed episodes.

    Both agree until the first episode is cut or can no longer be judged; from then on there is no interval.
    """
    times, failed = failure_times(group.verdicts, group["failed_step"])
    interval = survival_interval(~failed[:, None] | (times[:, None] > group.steps[None, kept]), group.runs, rng)
    watched = times[np.isin(group.verdicts, ["cannot tell"])].min(initial=group.steps[-1] + 1)
    lower, upper = (np.where(group.steps[kept] < watched, bound, np.nan) for bound in (interval.lower, interval.upper))
    return replace(interval, estimate=group.working[kept], lower=lower, upper=upper)


def thin(steps: IntArray, most: int) -> IntArray:
    """Return rising indices of at most `most` steps, half evenly on a log scale and half on a linear one."""
    if len(steps) <= most:
        return np.arange(len(steps))
    half = most // 2
    wanted = np.concatenate([np.geomspace(steps[0], steps[-1], most - half), np.linspace(steps[0], steps[-1], half)])
    after = np.clip(np.searchsorted(steps, wanted), 1, len(steps) - 1)
    nearer = after - (wanted - steps[after - 1] < steps[after] - wanted)
    return np.unique(nearer)


# Verdicts


@dataclass(frozen=True)
class Verdict:
    """The verdict on a group of episodes."""

    group: Group
    label: str
    """"holds" or one of FAILURES."""
    count: int
    """Episodes of that verdict."""
    share: Interval
    """Share of the episodes that hold, shape ()."""
    by_training_seed: Mapping[int, str]
    """The label of each training run by itself; empty where there is only one."""
    evidence: str
    """In words; "" where there is none."""

    @property
    def short(self) -> str:
        """Who, and the verdict: "ppo: falls in 4 of 10 episodes"."""
        group = self.group
        if self.label == "holds":
            return f"{group.label}: holds for {wording.whole(float(group.test_horizon))} steps"
        return f"{group.label}: {self.label}" + ("" if self.count == group.episodes else self._counted)

    @property
    def sentence(self) -> str:
        """Who, the verdict, how many episodes, the evidence, and which training runs hold."""
        low, high = float(self.share.lower), float(self.share.upper)
        counted = self._counted if self.label == "holds" or self.count == self.group.episodes else ""
        if self.label == "holds" and low < high:
            counted += f" (95 % interval {wording.share(low)} to {wording.share(high)})"
        elif self.label == "holds" and low == high:  # runs without a difference show no spread, which is no certainty
            counted += f" (the same share in each of {self.share.count} training runs)"
        return f"{self.short}{counted}" + (f"; {self.evidence}." if self.evidence else ".") + self._training_seeds

    @property
    def _counted(self) -> str:
        return f" in {self.count} of {wording.count(self.group.episodes, 'episode')}"

    @property
    def _training_seeds(self) -> str:
        """Which training runs hold: " By training seed: holds 0, 3; falls 1, 2."; "" where there is only one."""
        seeds: dict[str, list[int]] = {}
        for seed, label in sorted(self.by_training_seed.items()):
            seeds.setdefault(label, []).append(seed)
        count = len(self.by_training_seed)
        parts = [
            f"{label} " + (", ".join(map(str, found)) if count <= _MOST_LISTED else f"{len(found)} of {count}")
            for label in ("holds", *FAILURES)
            if (found := seeds.get(label))
        ]
        return f" By training seed: {'; '.join(parts)}." if parts else ""


def judge(group: Group, rng: np.random.Generator) -> Verdict:
    """Return the verdict on a group of episodes."""
    counts = Counter(group.verdicts)
    share = survival_interval(np.isin(group.verdicts, ["holds"]), group.runs, rng)
    label = _label(counts, float(share.estimate))
    by_seed: dict[int, str] = {}
    if len(np.unique(group.runs)) > 1:
        for (seed,), part in group.facts.group_by("train_seed"):
            mine = Counter(part["verdict"])
            by_seed[int(seed)] = _label(mine, mine["holds"] / mine.total())
    return Verdict(group, label, counts[label], share, by_seed, _evidence(group, label))


def _label(counts: Mapping[str, int], holding: float) -> str:
    """Return the verdict on episodes: how many had which outcome, and the share of them that hold."""
    if holding >= HOLDING_SHARE - ROUNDING:
        return "holds"
    return max(FAILURES, key=lambda each: (counts.get(each, 0), -FAILURES.index(each)))


def headline(verdicts: Sequence[Verdict]) -> str:
    """Return the verdict on every policy and clock of one task, one at least; if there are many, counts of each."""
    first = f"{verdicts[0].group.task}: "
    if all(verdict.label == "never worked" for verdict in verdicts):
        return first + "no policy works, even within its training horizon"
    if len(verdicts) <= _MOST_NAMED:
        return first + "; ".join(verdict.short for verdict in verdicts)
    counts = Counter(verdict.label for verdict in verdicts)
    parts = [f"{label} {counts[label]}" for label in ("holds", *FAILURES) if counts[label]]
    return f"{first}{len(verdicts)} policies and clocks: {', '.join(parts)}"


def _evidence(group: Group, label: str) -> str:
    episodes = group.facts.filter(verdict=label)
    if episodes.is_empty():
        return ""
    if label in ("never worked", "cannot tell"):
        notes = Counter(filter(None, episodes["note"]))
        return notes.most_common(1)[0][0] if notes else ""
    if label == "holds":
        if group.only_survival:
            return "every step pays the same, so only survival is judged"
        score = float(episodes["end_score_vs_training"].to_numpy().mean())
        paused = int(episodes["ever_idle"].sum())
        pauses = f"; {wording.count(paused, 'episode')} scored below 0.25 for a while" if paused else ""
        return f"score against its own training at the end: {score:.2f}{pauses}"
    began, ended = (episodes[name].to_numpy() for name in ("failed_step", "end_step"))
    middle = float(np.median(began))
    parts = [f"since step {wording.whole(middle)} (median)" if middle else "from the start"]
    if label in ("falls", "diverges"):
        idle = f"idle {parts[0]}, {label} " if (began < ended).mean() > 0.5 else ""
        parts = [f"{idle}at step {wording.whole(float(np.median(ended)))} (median)"]
    if label == "fails silently":
        parts += _instead(episodes)
    (detail, number), *_ = Counter(each.split(" left ")[0] for each in episodes["end_detail"]).most_common(1)
    if detail.startswith("observation[") and number > 1:
        parts.append(f"{detail} was the first to leave its training range in {number}")
    elif label == "diverges" and detail:
        parts.append(detail.split(";")[0])
    return "; ".join(parts)


def _instead(episodes: pl.DataFrame) -> list[str]:
    """Return the behavior of robots that fail silently, with counts, as text."""
    last, first = episodes["movement_last"].to_numpy(), episodes["movement_first"].to_numpy()
    early = episodes["failed_step"].to_numpy() < 0.1 * episodes["test_horizon"].to_numpy()
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = last / first
    kinds = np.select(
        [np.isnan(last), last < MOTIONLESS, early, ratio < 1 / MUCH, ratio > MUCH],
        ["", "nearly motionless", "moving", "moving less than before", "moving more than before"],
        "moving as much as before",
    )
    kind, number = Counter(kinds.tolist()).most_common(1)[0]
    worse = int((episodes["end_score_vs_training"].to_numpy() < -0.05).sum())
    parts = [(kind, number)] * bool(kind) + [("earning less than an idle robot", worse)] * bool(worse)
    return [what if count == len(last) else f"{what} in {count} of {len(last)}" for what, count in parts]


def endured(estimates: Sequence[Estimate]) -> Iterator[str]:
    """Yield for each policy and clock under several levels of one disturbance the level up to which it holds."""
    sweeps: dict[tuple[str, str], list[tuple[float, str, bool]]] = {}
    for item in estimates:
        disturbance = str(item.group["disturbance"][0])
        kind, _, level = disturbance.partition(":")
        if level and " " not in level:
            who = item.group.label.replace(f" under {disturbance}", "")
            amount = abs(float(level) - (kind in FACTORS))
            sweeps.setdefault((who, kind), []).append((amount, level, item.verdict.label == "holds"))
    for (who, kind), found in sweeps.items():
        levels = [level for _, level, _ in sorted(found)]
        held = list(takewhile(lambda each: each[2], sorted(found)))
        if len(found) > 1:
            up_to = f"up to {held[-1][1]}" if held else "at none of these levels"
            yield f"{who}: nine in ten episodes hold under {kind} {up_to} (tried: {', '.join(levels)})."


# Clocks


def best_clocks(estimates: Sequence[Estimate], rng: np.random.Generator) -> Iterator[str]:
    """Yield one sentence for each line with several clocks: the best one, and those as good as it.

    The best clock has the largest share of episodes that hold, and of those the highest mean return. Another one is as
    good unless it is worse in one of the two: unless the interval of its paired difference lies below 0. The intervals
    are not corrected for the number of clocks. `estimates` has the order of `make_groups`.
    """
    for line, items in groupby(estimates, key=lambda item: item.group.line):
        clocks = list(items)
        first = clocks[0].group
        if len(clocks) < 2 or any(
            len(first.paired(each.group)[0]) < max(first.episodes, each.group.episodes) for each in clocks
        ):
            continue
        best = best_clock(clocks)
        if not float(best.verdict.share.estimate):
            yield f"No episode of {line} holds under any of {len(clocks)} clocks."
            continue
        same = [item.group.clock_words for item in clocks if item is not best and _as_good(item.group, best.group, rng)]
        listed = ", ".join(same) if len(same) <= _MOST_CLOCKS else wording.count(len(same), "clock")
        yield (
            f"Best clock of {line} on these start states: {best.group.clock_words}."
            + (f" Not distinguishable from it (share that holds, return; 95 % each): {listed}." if same else "")
            + " Confirm it on others (--first-eval-seed)."
        )


def best_clock(estimates: Sequence[Estimate]) -> Estimate:
    """Return the clock with the largest share of episodes that hold, and of those the highest mean return."""
    return max(estimates, key=lambda item: (float(item.verdict.share.estimate), item.final_return))


def _as_good(group: Group, best: Group, rng: np.random.Generator) -> bool:
    mine, its = group.paired(best)
    measures = [[(each["verdict"] == "holds").astype(np.float64), each.returns[:, -1]] for each in (group, best)]
    for values, others in zip(*measures, strict=True):
        if float(mean_interval(values[mine] - others[its], group.runs[mine], rng).upper) < 0.0:
            return False
    return True
