"""Which charts a table gives: return and survival over steps, the choice of C, early against late."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from perdure.report import wording
from perdure.report.charts import Axis, Chart, Dash, Marker, Series
from perdure.report.estimates import Estimate
from perdure.report.groups import NO_CLOCK
from perdure.report.palette import FADED, INK, Colour, category, scale

MOST_CURVES = 8
"""Curves one chart shows without a colour scale; sweeps of C get charts of their own."""
_DASHES: dict[str, Dash] = {NO_CLOCK: "solid", "countdown": "dot", "constant": "solid", "periodic": "dash"}


def make_charts(estimates: Sequence[Estimate]) -> tuple[Chart, ...]:
    """Make the charts of one task.

    Args:
        estimates: The task's groups, at least one, in the order of `make_groups`.

    Returns:
        Return over steps and survival over steps; per swept method and kind of clock both again with all C; the final
        return against C when there are two or more values; reward per step early and late. Names are unique.
    """
    shown = overview(estimates)
    pairs = [("", shown, _paint(shown))]
    pairs += [(title, sweep, _paint(sweep)) for title, sweep in _sweeps(estimates) if len(shown) < len(estimates)]
    charts = []
    for title, chosen, colours in pairs:
        charts += [_return_chart(title, chosen, colours), _survival_chart(title, chosen, colours)]
    charts += _choice_chart(estimates)
    charts.append(_tenths_chart(estimates))
    return _name_apart(charts, estimates[0].group.task)


def overview(estimates: Sequence[Estimate]) -> list[Estimate]:
    """Choose what the first charts show: all groups if few, else the best C of each line and kind and what has no C."""
    if len(estimates) <= MOST_CURVES:
        return list(estimates)
    best: dict[tuple[str, str], Estimate] = {}
    for estimate in estimates:
        key = (estimate.group.line, estimate.group.clock_kind)
        if estimate.group.is_tuned_by_steps and (key not in best or _score(estimate) > _score(best[key])):
            best[key] = estimate
    chosen = [id(estimate) for estimate in best.values()]
    return [item for item in estimates if not item.group.is_tuned_by_steps or id(item) in chosen]


def _score(estimate: Estimate) -> float:
    return float(np.nan_to_num(estimate.final_return, nan=-np.inf))


def _sweeps(estimates: Sequence[Estimate]) -> list[tuple[str, list[Estimate]]]:
    """All C of one line and kind, beside every policy without a clock."""
    baselines = [item for item in estimates if item.group.clock_kind == NO_CLOCK]
    sweeps: dict[tuple[str, str], list[Estimate]] = {}
    for item in estimates:
        if item.group.is_tuned_by_steps:
            sweeps.setdefault((item.group.line, item.group.clock_kind), []).append(item)
    return [(f"{line}, {kind}(C)", baselines + sweep) for (line, kind), sweep in sweeps.items() if len(sweep) > 2]


def _paint(estimates: Sequence[Estimate]) -> list[Colour]:
    """Colours by C where one line is swept, by name otherwise."""
    tuned = [item.group for item in estimates if item.group.is_tuned_by_steps]
    values = sorted({group.clock_steps for group in tuned})
    if len(values) < 4 or len({group.line for group in tuned}) > 1:
        return [category(index) for index in range(len(estimates))]
    others = iter([INK, FADED, category(1), category(3), category(4)] * len(estimates))
    position = {value: index / (len(values) - 1) for index, value in enumerate(values)}
    return [scale(position[e.group.clock_steps]) if e.group.is_tuned_by_steps else next(others) for e in estimates]


def _curves(chosen: Sequence[Estimate], colours: Sequence[Colour], what: str) -> tuple[Series, ...]:
    lines = {item.group.line for item in chosen if item.group.is_tuned_by_steps}
    curves = []
    for item, colour in zip(chosen, colours, strict=True):
        interval, group = getattr(item, what), item.group
        swept = len(lines) == 1 and group.is_tuned_by_steps and len(chosen) > 3
        curves.append(
            Series(
                label=group.label,
                x=item.steps.astype(np.float64),
                y=interval.estimate,
                colour=colour,
                lower=interval.lower,
                upper=interval.upper,
                dash=_DASHES.get(group.clock_kind, "dashdot"),
                group=f"{group.line} \u00b7 {group.clock_kind}" if swept else group.line,
                tag=group.clock if swept else group.label,
            )
        )
    return tuple(curves)


def _step_axis(chosen: Sequence[Estimate]) -> Axis:
    steps = chosen[0].steps
    return Axis("steps since reset", log=len(steps) > 1, low=float(steps[0]), high=float(steps[-1]))


def _markers(chosen: Sequence[Estimate]) -> tuple[Marker, ...]:
    """Where training horizons end, inside the drawn steps; infinite and unknown ones have no place on the axis."""
    low, high = float(chosen[0].steps[0]), float(chosen[0].steps[-1])
    horizons = sorted({item.group.train_horizon for item in chosen if low < item.group.train_horizon < high})
    return tuple(Marker(at, f"training horizon {wording.whole(at)}") for at in horizons)


def _return_chart(title: str, chosen: Sequence[Estimate], colours: Sequence[Colour]) -> Chart:
    return Chart(
        name="-".join(["return", _slug(title)]),
        title="Return over steps" + (f": {title}" if title else ""),
        x=_step_axis(chosen),
        y=Axis("mean cumulative return"),
        series=_curves(chosen, colours, "returns"),
        markers=_markers(chosen),
        note=f"An ended lane keeps its return. {_bands(chosen)}",
    )


def _survival_chart(title: str, chosen: Sequence[Estimate], colours: Sequence[Colour]) -> Chart:
    return Chart(
        name="-".join(["survival", _slug(title)]),
        title="Survival over steps" + (f": {title}" if title else ""),
        x=_step_axis(chosen),
        y=Axis("share of lanes that have not ended", percent=True, low=0.0, high=1.0),
        series=_curves(chosen, colours, "survival"),
        markers=_markers(chosen),
        note=_bands(chosen),
    )


def _bands(chosen: Sequence[Estimate]) -> str:
    kinds = sorted({f"{item.returns.label} ({item.returns.method})" for item in chosen})
    return f"Bands: pointwise 95 % intervals over {' or '.join(kinds)}."


def _choice_chart(estimates: Sequence[Estimate]) -> list[Chart]:
    """Return at the end against C, with the clocks that have no C as level lines."""
    values = sorted({item.group.clock_steps for item in estimates if item.group.is_tuned_by_steps})
    if len(values) < 2:
        return []
    arms: dict[tuple[str, str], list[Estimate]] = {}
    for item in estimates:
        if item.group.is_tuned_by_steps:
            arms.setdefault((item.group.line, item.group.clock_kind), []).append(item)
    lines = list(dict.fromkeys(line for line, _ in arms))
    series = [_arm(line, kind, arm, category(lines.index(line))) for (line, kind), arm in arms.items()]
    level = [item for item in estimates if not item.group.is_tuned_by_steps]
    colours = [INK, FADED, *(category(len(lines) + index) for index in range(len(level)))]
    series += [_level(item, values, colour) for item, colour in zip(level, colours, strict=False)]
    last = wording.whole(float(estimates[0].steps[-1]))
    return [
        Chart(
            name="return-against-c",
            title=f"Return after {last} steps against C",
            x=Axis("C: the steps to go that the policy is told"),
            y=Axis("mean cumulative return"),
            series=tuple(series),
            note="Level lines have no C. The C that looks best here was chosen on these very lanes.",
        )
    ]


def _arm(line: str, kind: str, arm: Sequence[Estimate], colour: Colour) -> Series:
    return Series(
        label=f"{line} \u00b7 {kind}(C)",
        x=np.array([item.group.clock_steps for item in arm]),
        y=np.array([item.returns.estimate[-1] for item in arm]),
        colour=colour,
        lower=np.array([item.returns.lower[-1] for item in arm]),
        upper=np.array([item.returns.upper[-1] for item in arm]),
        dash=_DASHES.get(kind, "dashdot"),
        points=True,
        hollow=kind == "periodic",
        group=line,
        tag=f"{kind}(C)",
    )


def _level(item: Estimate, values: Sequence[float], colour: Colour) -> Series:
    ends = np.array([values[0], values[-1]], dtype=np.float64)
    bounds = [np.full(2, float(bound[-1])) for bound in (item.returns.lower, item.returns.upper)]
    return Series(
        label=item.group.label,
        x=ends,
        y=np.full(2, item.final_return),
        colour=colour,
        lower=bounds[0],
        upper=bounds[1],
        dash=_DASHES.get(item.group.clock_kind, "dashdot"),
        group=item.group.line,
        tag=item.group.label,
    )


def _tenths_chart(estimates: Sequence[Estimate]) -> Chart:
    places = np.arange(len(estimates), dtype=np.float64)

    def dots(label: str, what: str, colour: Colour, hollow: bool) -> Series:
        intervals = [getattr(item, what) for item in estimates]
        return Series(
            label=label,
            x=np.array([float(interval.estimate) for interval in intervals]),
            y=places,
            colour=colour,
            lower=np.array([float(interval.lower) for interval in intervals]),
            upper=np.array([float(interval.upper) for interval in intervals]),
            line=False,
            points=True,
            hollow=hollow,
        )

    return Chart(
        name="early-and-late",
        title="Reward per step: first and last tenth",
        x=Axis("mean reward per step"),
        y=Axis("", rows=tuple(item.group.label for item in estimates)),
        linked=True,
        series=(dots("first tenth", "first_tenth", FADED, True), dots("last tenth", "last_tenth", category(0), False)),
        note="A lane that ended earns 0 in its last tenth. A wide gap where lanes survive is a silent failure.",
    )


def _slug(text: str) -> str:
    """Reduce text to what a file name may hold anywhere."""
    return re.sub(r"[^A-Za-z0-9]+", "-", text).strip("-").lower()[:60]


def _name_apart(charts: Sequence[Chart], task: str) -> tuple[Chart, ...]:
    taken: set[str] = set()
    named = []
    for chart in charts:
        stem = "-".join(part for part in (_slug(task), chart.name.strip("-")) if part)
        name, number = stem, 2
        while name in taken:
            name, number = f"{stem}-{number}", number + 1
        taken.add(name)
        named.append(replace(chart, name=name))
    return tuple(named)
