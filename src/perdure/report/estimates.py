"""What a table says of each group: means with intervals, the verdict in words, and which clock of a policy is best.

The verdict on a group is *holds* if at least HOLDING_SHARE of its episodes hold, otherwise the most common other
outcome. Calm and disturbed episodes of a policy under a clock are summed up together. Clocks of one policy are compared
by paired differences on common start states.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import groupby, takewhile

import numpy as np
import polars as pl

from perdure.disturbances import CALM, neutral_level, split_text
from perdure.report import wording
from perdure.report.caveats import Held, find_caveats, listed
from perdure.report.groups import (
    ALL,
    MOSTLY_FALLS,
    NO_CLOCK,
    Group,
    failure_times,
    goal_evidence,
    make_groups,
    reaching,
    walk_evidence,
)
from perdure.report.outcomes import (
    ENDS_AT_ONE_STEP,
    FAILS_WHEN_DISTURBED,
    FALLS_IN_TRAINING,
    HELP,
    CannotTell,
    Cut,
    Diverges,
    FailsSilently,
    Falls,
    Holds,
    NeverWorked,
    ReachesGoal,
    failures,
    find_advice,
    outcome,
    outcome_words,
    verdicts_in_order,
)
from perdure.report.schema import Episodes, IntArray
from perdure.report.scores import END_SURVIVED, IDLE_BELOW
from perdure.stats import (
    EXACT,
    BoolArray,
    FailureRate,
    FloatArray,
    Interval,
    estimate_interval,
    make_units,
    mean_interval,
    survival_interval,
)

SEED = 0
"""Seed of the bootstrap: the same table gives the same intervals."""
MOST_POINTS = 80
"""Recorded steps drawn per curve; a table may hold many more."""
HOLDING_SHARE = 0.9
"""Share of its episodes that must hold for a policy to hold."""
MOTIONLESS = 0.04
"""Movement (see `MovementRecorder`) below which a robot is called nearly motionless."""
ROUNDING = 1e-9
"""Shares that differ by less are equal."""
CONSTANT_FROM = 0.05
"""Least p value at which a constant failure rate is believed."""
STEADY = 0.05
"""A motionless robot is so since the step after which its reward per step stays within this share of all it varied."""
_MOST_NAMED = 6
"""Most policies in a headline."""
_MOST_CLOCKS = 6
"""Most clocks in a sentence."""
_MOST_LISTED = 20
"""Most training runs whose seeds are listed."""


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
    working: Interval
    """Share of episodes without a failure so far (Kaplan-Meier), shape (points,); no bounds once an episode is cut."""
    final_score: Interval
    """Score against its own training at the end, ended episodes count 0; shape ()."""
    work_vs_calm: Interval
    """Mean work against the policy's own calm rate, see `perdure.report.work`; shape ()."""
    work_vs_published: Interval
    """Mean work against a published policy of the task; shape ()."""
    verdict: Verdict

    @property
    def final_return(self) -> float:
        """Mean return at the last recorded step."""
        return float(self.returns.estimate[-1])


Estimates = dict[str, list[Estimate]]
"""Every group's estimates by task, in the table's order."""


def estimate_table(table: pl.DataFrame | Sequence[Episodes], mine: pl.Expr = ALL) -> Estimates:
    """Estimate every group of a table, or of its episodes; see `make_groups`."""
    rng = np.random.default_rng(SEED)
    found = Estimates()
    for group in make_groups(table, mine):
        found.setdefault(group.task, []).append(estimate_group(group, rng))
    return {task: _with_caveats(estimates) for task, estimates in found.items()}


def _with_caveats(estimates: Sequence[Estimate]) -> list[Estimate]:
    """Return the estimates of a task, with the caveats of the groups that hold."""
    disturbed = Counter[str]()
    calm = dict[str, Group]()
    for item in estimates:
        if item.group.calm:
            calm[item.group.policy_and_clock] = item.group
        else:
            disturbed[item.group.policy_and_clock] += item.group.episodes
    found = []
    for item in estimates:
        caveats = dict[str, str]()
        if item.verdict.good:
            who = item.group.policy_and_clock
            held = Held(item.group, item.verdict.share, item.work_vs_calm, disturbed[who], calm.get(who))
            caveats = find_caveats(held)
        found.append(replace(item, verdict=replace(item.verdict, caveats=caveats)))
    return found


def estimate_group(group: Group, rng: np.random.Generator) -> Estimate:
    """Estimate a group: episodes averaged within training runs, intervals over runs (see `perdure.stats`)."""
    kept = thin(group.steps, MOST_POINTS)
    units = make_units(group.returns[:, kept], group.runs)
    return Estimate(
        group=group,
        steps=group.steps[kept],
        returns=estimate_interval(units, rng),
        return_units=units.values,
        working=_working(group, kept, rng),
        final_score=_known_mean(group, group.final_score, rng),
        # Own draws, so that the other intervals do not depend on whether there is work.
        work_vs_calm=_known_mean(group, group["work_vs_calm"], np.random.default_rng(SEED)),
        work_vs_published=_known_mean(group, group["work_vs_published"], np.random.default_rng(SEED)),
        verdict=judge(group, rng),
    )


def _known_mean(group: Group, values: FloatArray, rng: np.random.Generator) -> Interval:
    """Return the mean over the episodes whose value is known; nan where none is."""
    known = np.isfinite(values)
    rows = known if known.any() else np.ones_like(known)
    return mean_interval(values[rows], group.runs[rows], rng)


def _working(group: Group, kept: IntArray, rng: np.random.Generator) -> Interval:
    """Return the Kaplan-Meier curve over all episodes; the interval is that of the share of failed episodes.

    Both agree until the first episode is cut or can no longer be judged; from then on there is no interval.
    """
    times, failed = failure_times(group.verdicts, group["failed_step"])
    interval = survival_interval(~failed[:, None] | (times[:, None] > group.steps[None, kept]), group.runs, rng)
    watched = times[np.isin(group.verdicts, [CannotTell.name])].min(initial=group.steps[-1] + 1)
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
    """A word of `perdure.report.outcomes.verdicts_in_order`."""
    count: int
    """Episodes of that verdict."""
    share: Interval
    """Share of the episodes that hold or reach their goal, shape ()."""
    by_training_seed: Mapping[int, str]
    """The label of each training run by itself; empty where there is only one."""
    parts: tuple[str, ...]
    """The evidence in words, most important first."""
    caveats: Mapping[str, str] = field(default_factory=dict)
    """Why a policy that holds is not clean: reasons by name, see `perdure.report.caveats`."""

    @property
    def good(self) -> bool:
        """Whether the policy holds or reaches its goal."""
        return bool(outcome(self.label).good)

    @property
    def evidence(self) -> str:
        """The evidence as one text; "" where there is none."""
        return "; ".join(self.parts)

    @property
    def details(self) -> list[str]:
        """What `sentence` says of its subject, part by part, without the caveats."""
        seeds = self._training_seeds.strip().rstrip(".")
        return [f"{self.claim}{self._of_all}", *self.parts, *filter(None, [seeds])]

    @property
    def clean(self) -> bool:
        """Whether it holds or reaches its goal, without a caveat."""
        return self.good and not self.caveats

    @property
    def word(self) -> str:
        """The label, and whether there are caveats: "holds, but"."""
        return f"{self.label}, but" if self.caveats else self.label

    @property
    def ended(self) -> bool:
        """Whether the episodes of the verdict ended as failures: falls, or diverges."""
        return self.label in _ends()

    @cached_property
    def within(self) -> int:
        """Number of calm episodes that ended within the training horizon, if most did; else 0."""
        group = self.group
        early = (group["end_step"] <= group.train_horizon)[np.isin(group.verdicts, [self.label])].sum()
        known = self.ended and group.calm and np.isfinite(group.train_horizon)
        return int(early) if known and 2 * early > group.episodes else 0

    @property
    def kind(self) -> str:
        """What `find_advice` knows: the label, or that training was too short and not only this clock at fault.

        Falls that all come at one step are suspected to be a time limit, which needs no training.
        """
        group = self.group
        if self.ended and group.one_end is not None:
            return ENDS_AT_ONE_STEP
        if self.label == CannotTell.name and (group["outcome"] == Cut.name).mean() > 0.5:
            return Cut.name
        other_clock = group.clock_kind != NO_CLOCK and (group["training_falls"] <= MOSTLY_FALLS).all()
        short = self.ended and (group.falls_in_training or (self.within and not other_clock))
        return FALLS_IN_TRAINING if short else self.label

    @property
    def _counted(self) -> str:
        return f" in {self.count} of {wording.count(self.group.episodes, 'episode')}"

    @property
    def claim(self) -> str:
        """The verdict without its subject: "falls in 4 of 10 episodes"."""
        group = self.group
        remedy = ": train longer" if self.kind == FALLS_IN_TRAINING else ""
        if self.label == Holds.name:
            return f"{self.label} for {group.test_horizon:,} steps"
        if self.label == ReachesGoal.name:
            return reaching(group)
        if self.label == CannotTell.name and (parts := _behavior(group)):
            return f"{self.label}{self._counted}: {', '.join(parts)}"
        if _idle_first(group, self.label):
            mine = np.isin(group.verdicts, [self.label])
            began = _when("since", group["failed_step"][mine])
            ended = _when("at", group["end_step"][mine])
            return f"idle {began}; {_of(self.count, group.episodes, outcome(self.label).verb)} {ended}{remedy}"
        if self.within:
            counted = f"{self.within} of {wording.count(group.episodes, 'episode')}"
            return f"{self.label} within its own training horizon in {counted}{remedy}"
        return f"{self.label}{self._counted}{remedy}"

    @property
    def short(self) -> str:
        """Who, and the verdict: "ppo: falls in 4 of 10 episodes"."""
        return f"{self.group.label}: {self.claim}"

    @property
    def sentence(self) -> str:
        """Who, the verdict, how many episodes, the evidence, and which training runs hold."""
        evidence = f"; {self.evidence}." if self.evidence else "."
        caveats = f" But: {'; '.join(self.caveats.values())}." if self.caveats else ""
        return f"{self.short}{self._of_all}{evidence}{caveats}{self._training_seeds}"

    @property
    def _of_all(self) -> str:
        """How many episodes hold; "" for other verdicts, whose claim says it."""
        return self._counted + self._interval if self.label == Holds.name else ""

    @property
    def _interval(self) -> str:
        """The interval of the share that holds; "" where nothing varies."""
        low = float(self.share.lower)
        high = float(self.share.upper)
        if low < high:
            if self.group.runs_alike:
                return ""
            return f" (95 % interval {wording.share(low)} to {wording.share(high)})"
        if self.share.method != EXACT and self.share.count > 2:
            return f" (the same share in each of {self.share.count} training runs)"
        return ""

    @property
    def _training_seeds(self) -> str:
        """Which training runs hold: " By training seed: holds 0, 3; falls 1, 2."; "" where there is only one."""
        seeds: dict[str, list[int]] = {}
        for seed, label in sorted(self.by_training_seed.items()):
            seeds.setdefault(label, []).append(seed)
        count = len(self.by_training_seed)
        parts = []
        for label in verdicts_in_order():
            found = seeds.get(label, [])
            listed = ", ".join(map(str, found)) if count <= _MOST_LISTED else f"{len(found)} of {count}"
            if found:
                parts.append(f"{label} {listed}")
        return f" By training seed: {'; '.join(parts)}." if parts else ""


def _ends() -> list[str]:
    """Return the verdicts that say how episodes ended as failures: falls and diverges."""
    return outcome_words(good=False, by_end=True)


def judge(group: Group, rng: np.random.Generator) -> Verdict:
    """Return the verdict on a group of episodes."""
    good = outcome_words(good=True)
    counts = Counter(group.verdicts)
    share = survival_interval(np.isin(group.verdicts, good), group.runs, rng)
    if group.runs_alike and share.method == EXACT:
        share = replace(share, lower=np.array(np.nan), upper=np.array(np.nan))  # no spread is no certainty
    label = _label(counts, float(share.estimate))
    by_seed: dict[int, str] = {}
    if len(np.unique(group.runs)) > 1:
        for (seed,), part in group.facts.group_by("train_seed"):
            mine = Counter(part["verdict"])
            by_seed[int(seed)] = _label(mine, sum(mine[each] for each in good) / mine.total())
    evidence = (*_evidence(group, label), *goal_evidence(group, label), *walk_evidence(group))
    return Verdict(group, label, counts[label], share, by_seed, evidence)


def cannot_hold(group: Group, episodes: int) -> int:
    """Return how many episodes of a group do not hold, if too many for the group to hold with all of them; else 0.

    Args:
        group: Some of the episodes.
        episodes: How many the group has in the end.
    """
    missed = group.episodes - int(np.isin(group.verdicts, outcome_words(good=True)).sum())
    if episodes - missed >= HOLDING_SHARE * episodes - ROUNDING:
        return 0
    return missed


def _label(counts: Mapping[str, int], holding: float) -> str:
    """Return the verdict on episodes: how many had which outcome, and the share of them that is good."""
    good = outcome_words(good=True)
    if holding >= HOLDING_SHARE - ROUNDING:
        possible = good
    else:
        possible = [each for each in verdicts_in_order() if each not in good]
    return max(possible, key=lambda each: counts.get(each, 0))  # the first of equally common ones


def headline(verdicts: Sequence[Verdict]) -> str:
    """Return the verdict on every policy and clock of one task, one at least; if there are many, counts of each.

    Calm and disturbed episodes share a clause: "ppo: holds when calm; under standard-1 half of the episodes fail by
    step 600".
    """
    task = verdicts[0].group.task
    if all({*verdict.group.verdicts} == {NeverWorked.name} for verdict in verdicts):
        return f"{task}: no policy works, even within its training horizon"
    clauses: dict[str, list[Verdict]] = {}
    for verdict in verdicts:
        clauses.setdefault(verdict.group.policy_and_clock, []).append(verdict)
    if len(clauses) <= _MOST_NAMED:
        between = "; " if len(clauses) == 1 else ", "
        return f"{task}: " + "; ".join(_clause(mine, between) for mine in clauses.values())
    parts = []
    for disturbance, mine in groupby(verdicts, key=lambda verdict: verdict.group.condition):
        counts = Counter(verdict.label for verdict in mine)
        counted = ", ".join(f"{label} {counts[label]}" for label in verdicts_in_order() if counts[label])
        parts.append(counted if disturbance == CALM else f"under {disturbance} {counted}")
    return f"{task}: {len(clauses)} policies and clocks: {'; '.join(parts)}"


def _clause(verdicts: Sequence[Verdict], between: str) -> str:
    """Return the verdicts on one policy and clock, when calm and when disturbed."""
    first, *others = sorted(verdicts, key=lambda verdict: not verdict.group.calm)
    who = first.group.policy_and_clock
    but = ""
    if all(verdict.good for verdict in verdicts):
        but = listed([name for verdict in (first, *others) for name in verdict.caveats])
    if first.group.calm and (not others or first.kind in (NeverWorked.name, FALLS_IN_TRAINING)):
        return f"{who}: {first.claim}{but}"
    if first.group.calm and all(verdict.label == Holds.name for verdict in verdicts):
        under = " and ".join(f"for {each.group.test_horizon:,} under {each.group.condition}" for each in others)
        return f"{who}: {first.claim} when calm and {under}{but}"
    return f"{who}: {between.join(map(_condition, (first, *others)))}{but}"


def _condition(verdict: Verdict) -> str:
    """Return the verdict on one policy and clock under one condition, without its subject."""
    if verdict.group.calm:
        return _calm_condition(verdict)
    under = f"under {verdict.group.condition}"
    half = verdict.group.half_failed_by
    if verdict.label == CannotTell.name:
        return f"{verdict.label} {under}"
    if verdict.label == Holds.name:
        return f"{verdict.claim} {under}"
    if not np.isfinite(half) or verdict.label == NeverWorked.name:
        return f"{under} {verdict.claim}"
    return f"{under} half of the episodes fail " + (f"by step {wording.whole(half)}" if half else "from the start")


def _calm_condition(verdict: Verdict) -> str:
    if verdict.label in (CannotTell.name, Holds.name):
        return f"{verdict.label} when calm"
    return f"when calm {verdict.claim}"


def advice(verdicts: Sequence[Verdict]) -> tuple[str, str]:
    """Return what to do next about one policy under one clock, calm and disturbed, and its address."""
    first, *others = sorted(verdicts, key=lambda verdict: not verdict.group.calm)
    fails = next((verdict for verdict in (first, *others) if not verdict.good), first)
    only_disturbed = fails.kind in failures() and not fails.group.calm
    found = find_advice(FAILS_WHEN_DISTURBED if only_disturbed else fails.kind)
    return found.sentence, f"{HELP}#{found.section}"


# Evidence


def _evidence(group: Group, label: str) -> Iterator[str]:
    """Yield what supports the verdict on a group, most important first."""
    episodes = group.facts.filter(verdict=label)
    if episodes.is_empty():
        return
    by_goal = outcome(label).by_goal
    judged = label not in (NeverWorked.name, CannotTell.name)
    if not judged:
        notes = Counter(filter(None, episodes["note"]))
        yield from (note for note, _ in notes.most_common(1))
        yield from _behavior(group) if label == NeverWorked.name else ()
    elif label == Holds.name:
        yield from _holding(group, episodes)
    elif not by_goal:
        yield from _failing(group, label, episodes)
    if label != CannotTell.name and (alike := group.runs_alike):
        runs = len(np.unique(group.runs))
        where = f" in {alike} of {runs} training runs" if runs > 1 else ""
        yield f"{wording.count(len(np.unique(group['eval_seed'])), 'start state')} behave as one{where}"
    rate = group.failure_rate
    if rate is not None and not by_goal and label != CannotTell.name:
        yield from _per_hour(group, rate)


def _holding(group: Group, episodes: pl.DataFrame) -> Iterator[str]:
    """Yield how well episodes hold."""
    if (group["training_rate"] == group["idle_rate"]).all():
        return
    yield f"score against its own training at the end: {episodes['end_score_vs_training'].to_numpy().mean():.2f}"
    paused = int(episodes["ever_idle"].sum())
    if paused:
        yield f"{wording.count(paused, 'episode')} scored below {IDLE_BELOW:g} for a while"


def _failing(group: Group, label: str, episodes: pl.DataFrame) -> Iterator[str]:
    """Yield when episodes fail, and how the robots behave then."""
    count = len(episodes)
    if not _idle_first(group, label):
        began = episodes["failed_step"].to_numpy()
        half = group.half_failed_by
        by_half = f"half of the episodes have failed by step {wording.whole(half)}"
        together = _when("at" if label in _ends() else "since", began)
        yield by_half if np.ptp(began) and np.isfinite(half) else together
    if label == FailsSilently.name:
        still = episodes["movement_last"] < MOTIONLESS
        worse = episodes["end_score_vs_training"] < -0.05
        for what, found in (("nearly motionless", still), ("earning less than an idle robot", worse)):
            number = int(found.sum())
            if number:
                yield what if number == count else f"{what} in {number} of {count}"
    details = Counter(each.split(" left ")[0] for each in episodes["end_detail"])
    detail, number = details.most_common(1)[0]
    if detail.startswith("observation[") and number > 1:
        yield f"{detail} was the first to leave its training range in {number}"
    elif label == Diverges.name and detail:
        yield detail.split(";")[0]


def _per_hour(group: Group, rate: FailureRate) -> Iterator[str]:
    """Yield failures and hours: "falls 5 times in 20 h (mean time between failures 4.0 h, at least 1.9 h, ...)"."""
    only_falls = {*group.verdicts} & {*failures()} == {Falls.name}
    verb = Falls.name if only_falls else "fails"
    verb = f"{verb} {wording.count(rate.events, 'time')}" if rate.events else "no failure"
    mean = f"{wording.duration(rate.mean_hours)}, " if rate.events else ""
    least = f"{mean}at least {wording.duration(1.0 / rate.upper)}, one-sided 95 %"
    yield f"{verb} in {wording.duration(rate.exposure_hours)} (mean time between failures {least})"
    if early := int((group.failed & (group["failed_step"] <= group["settling"])).sum()):
        yield f"{early} more before they settled, within {wording.whole(float(group['settling'].max()))} steps"
    if rate.constant_p < CONSTANT_FROM and not group.failed.all():  # then the curve says when
        yield f"the failure rate is not constant: {rate.early} of {rate.events} in the first half of this time"


def _idle_first(group: Group, label: str) -> bool:
    """Return whether most episodes that ended were idle before."""
    if label not in _ends():
        return False
    mine = np.isin(group.verdicts, [label])
    return bool((group["failed_step"] < group["end_step"])[mine].mean() > 0.5)


def _when(word: str, steps: IntArray) -> str:
    """Return [500, 500] as "at step 500", [90, 500] as "at steps 90 to 500", and "since" step 0 as "from the start"."""
    low = wording.whole(float(steps.min()))
    high = wording.whole(float(steps.max()))
    if word == "since" and high == "0":
        return "from the start"
    return f"{word} step {low}" if low == high else f"{word} steps {low} to {high}"


def _of(number: int, total: int, verb: str) -> str:
    """Return "all 8 fall", "3 of 8 fall" or "1 of 8 falls"."""
    counted = f"all {total}" if 1 < number == total else f"{number} of {total}"
    return f"{counted} {verb}s" if number == 1 else f"{counted} {verb}"


def _behavior(group: Group) -> list[str]:
    """Return how episodes end and whether robots move, whatever they earn: "3 of 8 fall at steps 90 to 400"."""
    reason = group["end_reason"]
    survived = reason == END_SURVIVED
    last = group["movement_last"]  # nan where it is unknown: neither motionless nor moving
    found = {
        "fall": reason == "terminated",
        "diverge": reason == "diverged",
        "stay": survived & (last < MOTIONLESS),
        "move": survived & (last >= MOTIONLESS),
    }
    parts = []
    for verb, mine in found.items():
        if not mine.any():
            continue
        if verb == "stay":
            when = f"nearly motionless{_settled(group, mine)}"
        elif verb == "move":
            when = "until the end"
        else:
            when = _when("at", group["end_step"][mine])
        parts.append(f"{_of(int(mine.sum()), group.episodes, verb)} {when}")
    return parts


def _settled(group: Group, mine: BoolArray) -> str:
    """Return " since step 49": these episodes' reward per step hardly changes after it; "" if it changes to the end."""
    steps = np.concatenate([[0], group.steps])
    rates = np.diff(group.returns, axis=1, prepend=0.0) / np.diff(steps)
    late = rates[:, steps[1:] > 0.9 * steps[-1]].mean(axis=1, keepdims=True)
    varied = np.fmax(np.ptp(rates, axis=1), np.abs(group["training_rate"] - group["idle_rate"]))
    apart = np.abs(rates - late) > STEADY * varied[:, None]
    since = steps[(apart * np.arange(1, len(steps))).max(axis=1)][mine]
    return f" {_when('since', since)}" if since.max() <= 0.9 * steps[-1] else ""


def endured(estimates: Sequence[Estimate]) -> Iterator[str]:
    """Yield for each policy and clock under several levels of one disturbance the level up to which it holds.

    Levels at which no verdict is possible decide nothing; they are named.
    """
    sweeps: dict[tuple[str, str, bool], list[tuple[float, str, Verdict]]] = {}
    for item in estimates:
        disturbance = item.group.disturbance
        kind, level, time = split_text(disturbance)
        if level and " " not in disturbance:
            who = item.group.policy_and_clock
            amount = float(level) - neutral_level(kind)
            what = f"{kind}@{time}" if time else kind
            sweeps.setdefault((who, what, amount < 0), []).append((abs(amount), level, item.verdict))
    for (who, what, _), found in sweeps.items():
        tried = []
        judged = []
        for _, level, verdict in sorted(found, key=lambda each: each[:2]):
            if verdict.label == CannotTell.name:
                tried.append(f"{level} ({verdict.label})")
            else:
                tried.append(level)
                judged.append((level, verdict))
        held = [level for level, _ in takewhile(lambda each: each[1].good, judged)]
        if len(found) > 1 and judged:
            up_to = f"up to {held[-1]}" if held else "at none of these levels"
            yield f"{who}: nine in ten episodes hold under {what} {up_to} (tried: {', '.join(tried)})."


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
            f"Best clock of {line} on these start states: {best.group.clock_words} (--clocks {best.group.clock_flag})."
            + (f" Not distinguishable from it (share that holds, return; 95 % each): {listed}." if same else "")
            + " Confirm it on others (--first-eval-seed)."
        )


def best_clock(estimates: Sequence[Estimate]) -> Estimate:
    """Return the clock with the largest share of episodes that hold, and of those the highest mean return."""
    return max(estimates, key=lambda item: (round(float(item.verdict.share.estimate), 9), item.final_return))


def _as_good(group: Group, best: Group, rng: np.random.Generator) -> bool:
    mine, its = group.paired(best)
    good = outcome_words(good=True)
    measures = [[np.isin(each.verdicts, good).astype(np.float64), each.returns[:, -1]] for each in (group, best)]
    for values, others in zip(*measures, strict=True):
        if not float(mean_interval(values[mine] - others[its], group.runs[mine], rng).upper) >= 0.0:
            return False  # also where there are too few runs to say
    return True
