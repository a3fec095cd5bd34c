"""The figures of a task: failures, survival and reward over steps, the choice of C, the score at the end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from perdure.report import charts, wording
from perdure.report.charts import Axis, Curve, Figure, Level, Marker, Points, Style, curve_chart, point_chart, slug
from perdure.report.estimates import Estimate, best_clock
from perdure.report.groups import NO_CLOCK
from perdure.stats import FEWEST_FOR_INTERVAL, TRAINING_SEEDS, Interval

MOST_CURVES = 8
"""Curves one figure shows without a color scale; sweeps of C get separate figures."""
MOST_ROWS = 40
"""Policies and clocks in one figure of rows."""
_AT_THE_END = "Bars at the right: at the last step,"
_SELECTED = "Of every kind of clock the best C is shown, chosen on these episodes. "
_OVER_STEPS = {
    "working": (
        *("working", "Episodes that have not failed", "share of episodes that have not failed"),
        "Failure: a fall, a divergence, or a score against its own training that stays below 0.75 until the end. ",
    ),
    "survival": ("survival", "Episodes that have not ended", "share of episodes that have not ended", ""),
    # On a logarithmic axis, a cumulative return with linear growth would be curved.
    "returns": (
        *("reward", "Reward per step so far", "mean reward per step so far"),
        "Return so far, divided by the steps so far; an ended episode earns nothing more. ",
    ),
}
"""Field of `Estimate` to name, title, axis and note of its figure."""
Sweeps = dict[tuple[str, str], list[Estimate]]


def make_figures(estimates: Sequence[Estimate]) -> tuple[Figure, ...]:
    """Make the figures of one task.

    Args:
        estimates: The task's groups, at least one, in the order of `make_groups`.

    Returns:
        Episodes without failure, survival and reward over steps; per swept method and kind of clock these again with
        all C; the return at the end against C when there are two or more values; the score at the end.
    """
    shown = overview(estimates)
    some = len(shown) < len(estimates)
    figures = [_over_steps(what, "", shown, _SELECTED if some else "") for what in _OVER_STEPS]
    baselines = [item for item in estimates if item.group.clock_kind == NO_CLOCK]
    for (line, kind), sweep in _sweeps(estimates).items():
        if some and len(sweep) > 2:
            title = f"{line}, {wording.clock(kind, 'C')}"
            figures += [_over_steps(what, title, baselines + sweep) for what in _OVER_STEPS]
    figures += [*_against_c(estimates), *_score_at_the_end(estimates)]
    task = estimates[0].group.task
    return tuple(replace(each, name=slug(task, each.name), heading=task) for each in figures)


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


def _over_steps(what: str, title: str, chosen: Sequence[Estimate], selected: str = "") -> Figure:
    """Draw a field of `Estimate` over the recorded steps."""
    name, shown, axis, note = _OVER_STEPS[what]
    low, high = float(min(item.steps[0] for item in chosen)), float(max(item.steps[-1] for item in chosen))
    horizons = sorted({item.group.train_horizon for item in chosen if low < item.group.train_horizon < high})
    chart = curve_chart(
        _curves(chosen, what),
        Axis("steps since the reset", log=low < high, low=low, high=high),
        Axis(f"{axis} ({_episodes(chosen)})", percent=what != "returns"),
        markers=[Marker(at, f"training horizon, {wording.whole(at)} steps") for at in horizons],
        steps=what != "returns",
    )
    bands = "Bands: pointwise" if what == "returns" and len(chosen) <= MOST_CURVES else _AT_THE_END
    note = f"{selected}{note}{_notes(chosen, what, bands)}"
    return Figure(slug(name, title), ": ".join(filter(None, (shown, title))), chart, note)


def _curves(chosen: Sequence[Estimate], what: str) -> list[Curve]:
    """Return one curve for each group: returns divided by the steps so far, or a share of episodes."""
    per_step = what == "returns"
    swept = len(_sweeps(chosen)) == 1 and len(chosen) > MOST_CURVES // 2
    found = []
    for item, style in zip(chosen, _styles(chosen), strict=True):
        group, interval, steps = item.group, getattr(item, what), item.steps.astype(np.float64)
        divisor = steps if per_step else np.ones_like(steps)
        few = interval.count < FEWEST_FOR_INTERVAL
        found.append(
            Curve(
                label=f"C = {wording.whole(group.clock_steps)}" if swept and group.is_tuned_by_steps else group.label,
                x=steps,
                y=interval.estimate / divisor,
                style=style,
                lower=None if few else interval.lower / divisor,
                upper=None if few else interval.upper / divisor,
                members=item.return_units / divisor if few and per_step and interval.count > 1 else None,
                intervals="band" if per_step and len(chosen) <= MOST_CURVES else "last",
            )
        )
    return found


def _styles(chosen: Sequence[Estimate]) -> list[Style]:
    """Return styles: by C if one line is swept, else by name."""
    sweeps = _sweeps(chosen)
    values = sorted({item.group.clock_steps for sweep in sweeps.values() for item in sweep})
    if len(values) < 4 or len(sweeps) > 1:
        return [charts.style(index) for index in range(len(chosen))]
    others = iter(range(1, len(chosen) + 1))
    return [
        charts.ordered_style(values.index(item.group.clock_steps) / (len(values) - 1))
        if item.group.is_tuned_by_steps
        else replace(charts.style(next(others)), color=charts.INK)
        for item in chosen
    ]


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


def _against_c(estimates: Sequence[Estimate]) -> list[Figure]:
    """Draw the return at the end against C, with the clocks that have no C as level lines."""
    estimates = [item for item in estimates if item.steps[-1] == estimates[0].steps[-1]]
    sweeps = _sweeps(estimates)
    values = sorted({item.group.clock_steps for sweep in sweeps.values() for item in sweep})
    if len(values) < 2:
        return []
    lines = []
    for k, ((line, kind), sweep) in enumerate(sweeps.items()):
        steps, returns = [item.group.clock_steps for item in sweep], [item.final_return for item in sweep]
        columns = map(np.array, (steps, returns, *zip(*(item.returns.last() for item in sweep), strict=True)))
        x, y, lower, upper = columns
        label = f"{line}, {wording.clock(kind, 'C')}"
        lines.append(Curve(label, x, y, charts.style(k), lower, upper, marked=True, intervals="bars"))
    others = [item for item in estimates if not item.group.is_tuned_by_steps]
    levels = [
        Level(item.group.label, item.final_return, *item.returns.last(), replace(charts.style(k), color=charts.INK))
        for k, item in enumerate(others, 1)
    ]
    last = wording.whole(float(estimates[0].steps[-1]))
    chart = curve_chart(
        lines,
        Axis("C: steps to go given to the policy", low=-0.03 * values[-1]),
        Axis(f"mean return of {last} steps ({_episodes(estimates)})"),
        levels=levels,
    )
    over = _notes(estimates, "returns", "Bars:")
    note = f"{over} Level lines: clocks without C. The best C is optimistic: it was chosen on the episodes shown here."
    return [Figure("return-against-c", f"Return of {last} steps by the steps to go given to the policy", chart, note)]


def _score_at_the_end(estimates: Sequence[Estimate]) -> list[Figure]:
    """Draw the score at the end, if it is known; only of the first figures' groups if there are too many."""
    shown = estimates if len(estimates) <= MOST_ROWS else overview(estimates)
    known = [item for item in shown if np.isfinite(float(item.final_score.estimate))]
    if not known:
        return []
    middle = np.array([float(item.final_score.estimate) for item in known])
    lower, upper = np.array([item.final_score.last() for item in known]).T
    wide = len(known) > MOST_CURVES
    chart = point_chart(
        [f"{item.group.label} (n = {item.group.episodes})" for item in known],
        [Points("at the end", range(len(known)), middle, charts.style(0), lower, upper)],
        Axis("score against its own training (0: an idle robot, 1: as in training)", low=0.0),
        charts.WIDE if wide else charts.WIDTH,
    )
    over = _notes(known, "final_score", "Bars:")
    note = f"{over} Mean of the last tenth of the steps; an episode that ended counts 0."
    return [Figure("score", "Score at the end against its own training", chart, note, wide=wide)]
