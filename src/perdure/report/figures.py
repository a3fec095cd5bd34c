"""The figures of a task: failures over steps, speed against steps between failures, reward, the choice of C, scores."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from perdure.report import charts, wording
from perdure.report.charts import Axis, Curve, Figure, Level, Marker, Points, Style, curve_chart, point_chart, slug
from perdure.report.estimates import Estimate, best_clock
from perdure.report.groups import failure_times
from perdure.report.outcomes import outcome_words
from perdure.report.scores import HOLDS_FROM
from perdure.stats import FEWEST_FOR_INTERVAL, TRAINING_SEEDS, Interval, kaplan_meier

MOST_CURVES = 8
"""Curves one figure shows without a color scale; sweeps of C get separate figures."""
MOST_ROWS = 40
"""Policies and clocks in one figure of rows."""
HALF = 600
"""Width of each of two figures of failures. [px]"""
_SELECTED = "Of every kind of clock the best C is shown, chosen on these episodes. "
_FAILURE = (
    "Failure: a fall, a divergence, or a score against its own training that stays below "
    f"{HOLDS_FROM:g} until the end. "
)
Sweeps = dict[tuple[str, str], list[Estimate]]


def make_figures(estimates: Sequence[Estimate]) -> tuple[list[Figure], list[Figure]]:
    """Make the figures of one task.

    Args:
        estimates: The task's groups, at least one, in the order of `make_groups`. Groups of different disturbances may
            have different test horizons and recorded steps.

    Returns:
        (for the top of a page: failures over steps; the others: speed against steps between failures if there are
        several training runs or groups, reward over steps, both curves with all C for each swept method and kind of
        clock, return against C, the score at the end).
    """
    shown = overview(estimates)
    some = len(shown) < len(estimates)
    selected = _SELECTED if some else ""
    top = [_failures(items, condition, shown, selected) for condition, items in _panels(shown)]
    others = [_reward(items, condition, shown, selected) for condition, items in _panels(shown)]
    for condition, items in _panels(estimates):
        for (line, kind), sweep in _sweeps(items).items():
            if some and len(sweep) > 2:
                title = f"{line}, {wording.clock(kind, 'C')}"
                drawn = [item for item in items if not item.group.is_tuned_by_steps] + sweep
                others += [draw(drawn, title, drawn, "") for draw in (_failures, _reward)]
        others += _against_c(items, condition)
    task = estimates[0].group.task
    parts = (top, [*_plane(shown, selected), *others, *_score_at_the_end(estimates)])
    top, others = ([replace(each, name=slug(task, each.name), heading=task) for each in part] for part in parts)
    return top, others


def overview(estimates: Sequence[Estimate]) -> list[Estimate]:
    """Choose the groups of the first figures: all groups, or the best C of each line and kind and all without C."""
    if len(estimates) <= MOST_CURVES:
        return list(estimates)
    chosen = [id(best_clock(sweep)) for sweep in _sweeps(estimates).values()]
    return [item for item in estimates if not item.group.is_tuned_by_steps or id(item) in chosen]


def _sweeps(estimates: Sequence[Estimate]) -> Sweeps:
    """Return the groups whose clock has a C, by line and kind of clock."""
    sweeps: Sweeps = {}
    for item in estimates:
        if item.group.is_tuned_by_steps:
            sweeps.setdefault((item.group.line, item.group.clock_kind), []).append(item)
    return sweeps


def _panels(estimates: Sequence[Estimate]) -> list[tuple[str, list[Estimate]]]:
    """Return the groups by the length of their episodes, each part with what it has in common in words."""
    parts: dict[int, list[Estimate]] = {}
    for item in estimates:
        parts.setdefault(item.group.test_horizon, []).append(item)
    found = []
    for steps, items in parts.items():
        conditions = {item.group.disturbance for item in items}
        words = "calm" if all(item.group.calm for item in items) else f"under {', '.join(sorted(conditions))}"
        words = words if len(conditions) == 1 else f"{wording.whole(steps)} steps"
        found.append((words if len(parts) > 1 else "", items))
    return found


def _failures(chosen: Sequence[Estimate], title: str, shown: Sequence[Estimate], selected: str) -> Figure:
    """Draw the share of episodes without a failure so far; it falls at the exact steps of the failures."""
    known = [failure_times(item.group.verdicts, item.group["failed_step"]) for item in chosen]
    high = float(max(item.group.test_horizon for item in chosen))
    # The axis begins at the power of ten below the first failure, or two before the end.
    first = min(high / 100.0, *(float(times[failed].min(initial=int(high))) for times, failed in known))
    low = 10.0 ** math.floor(math.log10(max(first, 1.0)))
    lines = []
    for item, look, (times, failed) in zip(chosen, _styles(chosen, shown), known, strict=True):
        at, share = kaplan_meier(times, failed)
        lower, upper = (np.full(len(at) + 2, np.nan) for _ in range(2))
        if item.working.count >= FEWEST_FOR_INTERVAL and np.isfinite(item.verdict.share.lower):
            lower[-1], upper[-1] = item.working.last()
        x = np.clip([low, *at, float(item.group.test_horizon)], low, high)
        y = np.array([1.0, *share, share[-1]])
        watched = times.astype(np.float64)
        label = _label(item, chosen)
        lines.append(Curve(label, x, y, look, lower, upper, intervals="last", watched=watched))
    axis = Axis(f"share without a failure ({_episodes(chosen)})", percent=True)
    chart = curve_chart(
        *(lines, Axis("steps since the reset", log=high > low, low=low, high=high), axis),
        markers=_horizons(chosen, low, high),
        steps=True,
        width=HALF if title else charts.WIDE,
    )
    note = f"{selected}{_FAILURE}{_notes(chosen, 'working', 'Bars where episodes differ: at the last step,')}"
    return Figure(slug("working", title), _titled("Episodes that have not failed", title), chart, note, wide=not title)


def _reward(chosen: Sequence[Estimate], title: str, shown: Sequence[Estimate], selected: str) -> Figure:
    """Draw the mean reward per step so far; on a logarithmic axis a cumulative return would be curved."""
    lines = []
    bands = len(chosen) <= MOST_CURVES
    low, high = (float(end(item.steps[k] for item in chosen)) for end, k in ((min, 0), (max, -1)))
    for item, look in zip(chosen, _styles(chosen, shown), strict=True):
        found = item.returns
        steps = item.steps.astype(np.float64)
        lower = found.lower / steps
        upper = found.upper / steps
        members = item.return_units / steps if 1 < found.count < FEWEST_FOR_INTERVAL else None
        intervals: Literal["band", "last"] = "band" if bands else "last"
        label = _label(item, chosen)
        lines.append(Curve(label, steps, found.estimate / steps, look, lower, upper, members, intervals=intervals))
    chart = curve_chart(
        lines,
        Axis("steps since the reset", log=high > low, low=low, high=high),
        Axis(f"mean reward per step ({_episodes(chosen)})"),
        markers=_horizons(chosen, low, high),
    )
    over = _notes(chosen, "returns", "Bands: pointwise" if bands else "Bars at the right: at the last step,")
    note = f"{selected}Return so far, divided by the steps so far; an ended episode earns nothing more. {over}"
    return Figure(slug("reward", title), _titled("Reward per step so far", title), chart, note)


def _titled(first: str, more: str) -> str:
    return f"{first}: {more}" if more else first


def _horizons(chosen: Sequence[Estimate], low: float, high: float) -> list[Marker]:
    """Return the training horizons between the ends of the axis."""
    found = sorted({item.group.train_horizon for item in chosen if low < item.group.train_horizon < high})
    return [Marker(at, f"training horizon, {wording.whole(at)} steps") for at in found]


def _label(item: Estimate, chosen: Sequence[Estimate]) -> str:
    """Return the name of a curve: without the disturbance where all curves have it, "C = 500" in a sweep."""
    group = item.group
    alike = len({each.group.disturbance for each in chosen}) == 1
    swept = len(_sweeps(chosen)) == 1 and len(chosen) > MOST_CURVES // 2
    if swept and group.is_tuned_by_steps:
        return f"C = {wording.whole(group.clock_steps)}"
    return group.policy_and_clock if alike else group.label


def _styles(chosen: Sequence[Estimate], shown: Sequence[Estimate]) -> list[Style]:
    """Return styles: by C if one line is swept, else a color for a policy and clock, dashed if disturbed."""
    sweeps = _sweeps(chosen)
    values = sorted({item.group.clock_steps for sweep in sweeps.values() for item in sweep})
    if len(values) < 4 or len(sweeps) > 1:
        names = list(dict.fromkeys(item.group.policy_and_clock for item in shown))
        conditions = list(dict.fromkeys(item.group.disturbance for item in shown))
        found = [charts.style(names.index(item.group.policy_and_clock)) for item in chosen]
        if len(conditions) == 1:
            return found
        dashed = [charts.style(conditions.index(item.group.disturbance)) for item in chosen]
        return [replace(look, dash=other.dash, shape=other.shape) for look, other in zip(found, dashed, strict=True)]
    others = iter(range(1, len(chosen) + 1))
    return [
        charts.ordered_style(values.index(item.group.clock_steps) / (len(values) - 1))
        if item.group.is_tuned_by_steps
        else replace(charts.style(next(others)), color=charts.INK)
        for item in chosen
    ]


def _plane(shown: Sequence[Estimate], selected: str) -> Iterator[Figure]:
    """Draw speed while working against steps between failures, one point for each training run of a group.

    Tasks that end at the goal have none: how much reward they pay until then says nothing.
    """
    if any({*outcome_words(by_goal=True)} & {*item.group.verdicts} for item in shown):
        return
    lines = list[Curve]()
    unfailed = list[charts.Row]()
    for item, look in zip(shown, _styles(shown, shown), strict=True):
        group = item.group
        label = f"{group.label}: {_holding_and_work(item)}"
        times, failed = failure_times(group.verdicts, group["failed_step"])
        times = np.minimum(times, group["end_step"])
        # An ended episode has all its reward at the next recorded step; any other is read at the last one before.
        places = np.searchsorted(group.steps, times, side="right") - 1
        places = np.where(times < group["end_step"], places.clip(0), np.searchsorted(group.steps, times))
        earned = group.returns[np.arange(group.episodes), places]
        steps = np.minimum(group.steps[places], group["end_step"])
        points = []
        for run in np.unique(group.runs):
            mine = (group.runs == run) & (times > 0)
            failures = failed[group.runs == run].sum()
            if mine.any():
                speed = earned[mine].sum() / steps[mine].sum() - group["idle_rate"][mine].mean()
                points.append((times[mine].sum() / max(failures, 1), speed))
                if not failures:
                    unfailed.append({"x": points[-1][0], "y": points[-1][1], "label": label, "text": "\u2192"})
        if points:
            x, y = np.array(sorted(points)).T
            lines.append(Curve(label, x, y, look, marked=True, joined=False))
    every = np.concatenate([each.x for each in lines]) if lines else np.zeros(0)
    if len(every) < 2:
        return
    low = math.floor(math.log10(every.min() / 1.1))
    high = math.ceil(math.log10(every.max() * 1.1))
    across = Axis("steps between failures", log=True, low=10.0**low, high=10.0**high)
    chart = curve_chart(lines, across, Axis("reward per step, above an idle robot's"))
    if unfailed:
        at = {name: {"field": name, "type": "quantitative"} for name in ("x", "y")}
        arrow = {"align": "left", "baseline": "middle", "dx": 6, "fontSize": 16, "color": charts.INK}
        chart["layer"].append(charts.layer(unfailed, "text", arrow, **at, text=charts.named("text")))
    note = (
        f"{selected}One point for each training run and condition: all steps before failures, divided by the number of "
        "failures. Up and to the right is better. Arrow: no failure was seen, the point is at all its steps. Work: "
        "what episodes earn above an idle robot, falls included, as a share of what the policy earns when calm."
    )
    yield Figure("plane", "Speed while working against steps between failures", chart, note)


def _holding_and_work(item: Estimate) -> str:
    """Return the share of episodes that hold and the mean work against calm: "83 % hold, work 0.62"."""
    work = float(item.work_vs_calm.estimate)
    said = f"{wording.share(float(item.verdict.share.estimate))} hold"
    return said if math.isnan(work) else f"{said}, work {work:.2f}"


def _episodes(chosen: Sequence[Estimate]) -> str:
    return wording.sample([item.group.episodes for item in chosen], "episode")


def _notes(chosen: Sequence[Estimate], what: str, name: str) -> str:
    """Return the note on intervals: kind, sample size, and what is drawn if there are too few units."""
    intervals: list[Interval] = [getattr(item, what) for item in chosen]
    many = [each for each in intervals if each.count >= FEWEST_FOR_INTERVAL]
    parts = []
    for label, method in dict.fromkeys((each.label, each.method) for each in many):
        counts = [each.count for each in many if (each.label, each.method) == (label, method)]
        over = f"{wording.sample(counts, 'start state')}, from one training run"
        over = wording.sample(counts, "training run") if label == TRAINING_SEEDS else over
        parts.append(f"{name} 95 % intervals ({method}) over {over}.")
    if len(many) < len(intervals):
        parts.append(f"No interval where n is less than {FEWEST_FOR_INTERVAL}.")
    if what == "returns" and any(each.count == 2 for each in intervals):
        parts.append("Thin lines: the two means that a curve is the mean of.")
    return " ".join(parts)


def _against_c(chosen: Sequence[Estimate], words: str) -> Iterator[Figure]:
    """Draw the return at the end against C, with the clocks that have no C as level lines."""
    sweeps = _sweeps(chosen)
    values = sorted({item.group.clock_steps for sweep in sweeps.values() for item in sweep})
    if len(values) < 2:
        return
    lines = []
    for k, ((line, kind), sweep) in enumerate(sweeps.items()):
        steps = [item.group.clock_steps for item in sweep]
        returns = [item.final_return for item in sweep]
        columns = map(np.array, (steps, returns, *zip(*(item.returns.last() for item in sweep), strict=True)))
        x, y, lower, upper = columns
        label = f"{line}, {wording.clock(kind, 'C')}"
        lines.append(Curve(label, x, y, charts.style(k), lower, upper, marked=True, intervals="bars"))
    others = [item for item in chosen if not item.group.is_tuned_by_steps]
    levels = [
        Level(item.group.label, item.final_return, *item.returns.last(), replace(charts.style(k), color=charts.INK))
        for k, item in enumerate(others, 1)
    ]
    last = wording.whole(float(chosen[0].steps[-1]))
    chart = curve_chart(
        lines,
        Axis("C: steps to go given to the policy", low=-0.03 * values[-1]),
        Axis(f"mean return of {last} steps ({_episodes(chosen)})"),
        levels=levels,
    )
    over = _notes(chosen, "returns", "Bars:")
    note = f"{over} Level lines: clocks without C. The best C is optimistic: it was chosen on the episodes shown here."
    title = _titled(f"Return of {last} steps by the steps to go given to the policy", words)
    yield Figure(slug("return-against-c", words), title, chart, note)


def _score_at_the_end(estimates: Sequence[Estimate]) -> Iterator[Figure]:
    """Draw the score at the end, if it is known; only of the first figures' groups if there are too many."""
    shown = estimates if len(estimates) <= MOST_ROWS else overview(estimates)
    known = [item for item in shown if np.isfinite(float(item.final_score.estimate))]
    if not known:
        return
    middle = np.array([float(item.final_score.estimate) for item in known])
    lower, upper = np.array([item.final_score.last() for item in known]).T
    wide = len(known) > MOST_CURVES
    chart = point_chart(
        [f"{item.group.label} (n = {item.group.episodes})" for item in known],
        [Points("at the end", range(len(known)), middle, charts.style(0), lower, upper)],
        Axis("score against its own training (0: an idle robot, 1: as in training)", low=0.0, high=1.0),
        charts.WIDE if wide else charts.WIDTH,
    )
    over = _notes(known, "final_score", "Bars:")
    note = f"{over} Mean of the last tenth of the steps; an episode that ended counts 0."
    yield Figure("score", "Score at the end against its own training", chart, note, wide=wide)
