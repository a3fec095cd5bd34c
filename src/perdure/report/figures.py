"""The figures of a table: failures, survival and reward over steps, the choice of C, the score at the end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from perdure.report import theme, wording
from perdure.report.axes import Axis, FloatArray
from perdure.report.comparisons import best_clock
from perdure.report.curves import Curve, Level, Marker, curve_chart
from perdure.report.estimates import Estimate
from perdure.report.groups import NO_CLOCK
from perdure.report.render import Figure, slug
from perdure.report.rows import Points, point_chart
from perdure.report.statistics import FEWEST_FOR_INTERVAL, TRAINING_SEEDS, Interval
from perdure.report.theme import Style

MOST_CURVES = 8
"""Curves one figure shows without a color scale; sweeps of C get separate figures."""
MOST_ROWS = 40
"""Policies and clocks in one figure of rows."""
_AT_THE_END = "Bars at the right: at the last step,"
_SELECTED = "Of every kind of clock the best C is shown, chosen on these episodes. "
_FAILURE = "Failure: a fall, a divergence, or a hold score that stays below 0.75 until the end. "


def make_figures(estimates: Sequence[Estimate]) -> tuple[Figure, ...]:
    """Make the figures of one task.

    Args:
        estimates: The task's groups, at least one, in the order of `make_groups`.

    Returns:
        Episodes without failure, survival and reward over steps; per swept method and kind of clock these again with
        all C; the return at the end against C when there are two or more values; the hold score at the end.
    """
    shown = overview(estimates)
    chosen = [("", shown)]
    chosen += [(title, sweep) for title, sweep in _sweeps(estimates) if len(shown) < len(estimates)]
    figures: list[Figure] = []
    for title, part in chosen:
        selected = _SELECTED if part is shown and len(shown) < len(estimates) else ""
        made = [
            _share_figure("working", "failed", title, part, _FAILURE),
            _share_figure("survival", "ended", title, part),
            _reward_figure(title, part),
        ]
        figures += [replace(each, note=f"{selected}{each.note}") for each in made]
    figures += [*_choice_figure(estimates), *_hold_figure(estimates)]
    task = estimates[0].group.task
    return tuple(replace(each, name=slug(task, each.name), heading=task) for each in figures)


def overview(estimates: Sequence[Estimate]) -> list[Estimate]:
    """Choose the groups of the first figures: all groups, or the best C of each line and kind and all without C."""
    if len(estimates) <= MOST_CURVES:
        return list(estimates)
    chosen = [id(best_clock(sweep)) for sweep in _by_line_and_kind(estimates).values()]
    return [item for item in estimates if not item.group.is_tuned_by_steps or id(item) in chosen]


def _sweeps(estimates: Sequence[Estimate]) -> list[tuple[str, list[Estimate]]]:
    """Return all C of one line and kind, with every policy without a clock."""
    baselines = [item for item in estimates if item.group.clock_kind == NO_CLOCK]
    sweeps = _by_line_and_kind(estimates).items()
    found = [(line, wording.clock(kind, "C"), sweep) for (line, kind), sweep in sweeps if len(sweep) > 2]
    return [(f"{line}, {clock}", baselines + sweep) for line, clock, sweep in found]


def _by_line_and_kind(estimates: Sequence[Estimate]) -> dict[tuple[str, str], list[Estimate]]:
    """Return the groups whose clock has a C, by line and kind of clock."""
    sweeps: dict[tuple[str, str], list[Estimate]] = {}
    for item in estimates:
        if item.group.is_tuned_by_steps:
            sweeps.setdefault((item.group.line, item.group.clock_kind), []).append(item)
    return sweeps


def _styles(chosen: Sequence[Estimate]) -> list[Style]:
    """Return styles: by C if one line is swept, else by name."""
    tuned = [item.group for item in chosen if item.group.is_tuned_by_steps]
    values = sorted({group.clock_steps for group in tuned})
    if len(values) < 4 or len({(group.line, group.clock_kind) for group in tuned}) > 1:
        return [theme.style(index) for index in range(len(chosen))]
    place = {value: index / (len(values) - 1) for index, value in enumerate(values)}
    others = iter(range(1, len(chosen) + 1))
    return [
        theme.ordered_style(place[item.group.clock_steps])
        if item.group.is_tuned_by_steps
        else replace(theme.style(next(others)), color=theme.INK)
        for item in chosen
    ]


def _curves(chosen: Sequence[Estimate], what: Literal["returns", "survival", "working"]) -> list[Curve]:
    """Return one curve for each group: returns divided by the steps so far, or a share of episodes."""
    per_step = what == "returns"
    tuned = {(item.group.line, item.group.clock_kind) for item in chosen if item.group.is_tuned_by_steps}
    found = []
    for item, style in zip(chosen, _styles(chosen), strict=True):
        interval: Interval = getattr(item, what)
        steps = item.steps.astype(np.float64)
        divisor = steps if per_step else np.ones_like(steps)
        swept = len(tuned) == 1 and len(chosen) > MOST_CURVES // 2 and item.group.is_tuned_by_steps
        few = interval.count < FEWEST_FOR_INTERVAL
        found.append(
            Curve(
                label=f"C = {wording.whole(item.group.clock_steps)}" if swept else item.group.label,
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


def _step_axis(chosen: Sequence[Estimate]) -> Axis:
    steps = chosen[0].steps
    return Axis("steps since the reset", log=len(steps) > 1, low=float(steps[0]), high=float(steps[-1]))


def _markers(chosen: Sequence[Estimate]) -> tuple[Marker, ...]:
    """Return markers at the ends of training horizons within the drawn steps; infinite and unknown ones have none."""
    low, high = float(chosen[0].steps[0]), float(chosen[0].steps[-1])
    horizons = sorted({item.group.train_horizon for item in chosen if low < item.group.train_horizon < high})
    return tuple(Marker(at, f"training horizon, {wording.whole(at)} steps") for at in horizons)


def _reward_figure(title: str, chosen: Sequence[Estimate]) -> Figure:
    """Draw reward per step so far. On a logarithmic axis, a cumulative return with linear growth would be curved."""
    chart = curve_chart(
        _curves(chosen, "returns"),
        _step_axis(chosen),
        Axis(f"mean reward per step so far ({_episodes(chosen)})"),
        markers=_markers(chosen),
    )
    bands = "Bands: pointwise" if len(chosen) <= MOST_CURVES else _AT_THE_END
    note = "Return so far, divided by the steps so far; an ended episode earns nothing more. "
    note += _notes(chosen, "returns", bands)
    name = slug("reward", title)
    return Figure(name, ": ".join(filter(None, ("Reward per step so far", title))), chart, note)


def _share_figure(
    name: Literal["working", "survival"], happened: str, title: str, chosen: Sequence[Estimate], note: str = ""
) -> Figure:
    """Draw the share of episodes to which something has not `happened`."""
    chart = curve_chart(
        _curves(chosen, name),
        _step_axis(chosen),
        Axis(f"share of episodes that have not {happened} ({_episodes(chosen)})", percent=True),
        markers=_markers(chosen),
        steps=True,
    )
    shown = ": ".join(filter(None, (f"Episodes that have not {happened}", title)))
    return Figure(slug(name, title), shown, chart, note + _notes(chosen, name, _AT_THE_END))


def _episodes(chosen: Sequence[Estimate]) -> str:
    return wording.sample([item.group.lanes for item in chosen], "episode")


def _notes(chosen: Sequence[Estimate], what: str, name: str) -> str:
    """Return the note on intervals: kind, sample size, and what is drawn if there are too few units."""
    intervals = [getattr(item, what) for item in chosen]
    parts = []
    many = [each for each in intervals if each.count >= FEWEST_FOR_INTERVAL]
    kinds = dict.fromkeys((each.label, each.method) for each in many)
    for label, method in kinds:
        counts = [each.count for each in many if (each.label, each.method) == (label, method)]
        if label == TRAINING_SEEDS:
            over = wording.sample(counts, "training run")
        else:
            over = f"{wording.sample(counts, 'start state')}, from one training run"
        parts.append(f"{name} 95 % intervals ({method}) over {over}.")
    if len(many) < len(intervals):
        parts.append(f"No interval where n is less than {FEWEST_FOR_INTERVAL}.")
    if what == "returns" and any(each.count == 2 for each in intervals):
        parts.append("Thin lines: the two means that a curve is the mean of.")
    return " ".join(parts)


def _choice_figure(estimates: Sequence[Estimate]) -> list[Figure]:
    """Return at the end against C, with the clocks that have no C as level lines."""
    sweeps = _by_line_and_kind(estimates)
    values = sorted({item.group.clock_steps for sweep in sweeps.values() for item in sweep})
    if len(values) < 2:
        return []
    lines = [_sweep(line, kind, sweep, theme.style(k)) for k, ((line, kind), sweep) in enumerate(sweeps.items())]
    level = [item for item in estimates if not item.group.is_tuned_by_steps]
    levels = [
        Level(item.group.label, item.final_return, *_bounds(item.returns), replace(theme.style(k + 1), color=theme.INK))
        for k, item in enumerate(level)
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


def _sweep(line: str, kind: str, sweep: Sequence[Estimate], style: Style) -> Curve:
    lower, upper = zip(*(_bounds(item.returns) for item in sweep), strict=True)
    return Curve(
        label=f"{line}, {wording.clock(kind, 'C')}",
        x=np.array([item.group.clock_steps for item in sweep]),
        y=np.array([item.final_return for item in sweep]),
        style=style,
        lower=np.array(lower),
        upper=np.array(upper),
        marked=True,
        intervals="bars",
    )


def _bounds(interval: Interval) -> tuple[float, float]:
    """Return the last bounds; nan where there are too few units."""
    few = interval.count < FEWEST_FOR_INTERVAL
    lower, upper = (float(np.ravel(bound)[-1]) for bound in (interval.lower, interval.upper))
    return (np.nan, np.nan) if few else (lower, upper)


def _hold_figure(estimates: Sequence[Estimate]) -> list[Figure]:
    """Draw the hold score at the end, if it is known; only of the first figures' groups if there are too many."""
    shown = estimates if len(estimates) <= MOST_ROWS else overview(estimates)
    known = [item for item in shown if np.isfinite(float(item.final_hold.estimate))]
    if not known:
        return []
    intervals = [item.final_hold for item in known]
    bounds = np.array([_bounds(interval) for interval in intervals])
    middle: FloatArray = np.array([float(interval.estimate) for interval in intervals])
    wide = len(known) > MOST_CURVES
    chart = point_chart(
        [f"{item.group.label} (n = {item.group.lanes})" for item in known],
        [Points("at the end", range(len(known)), middle, theme.style(0), bounds[:, 0], bounds[:, 1])],
        Axis("hold score (1: as in training, 0: no better than idle)", low=0.0),
        theme.WIDE if wide else theme.WIDTH,
    )
    note = (
        f"{_notes(known, 'final_hold', 'Bars:')} Mean of the last tenth of the steps; an episode that ended counts 0."
    )
    return [Figure("hold", "Gain over an idle robot at the end, beside that in training", chart, note, wide=wide)]
