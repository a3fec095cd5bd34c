"""Return of the test horizon against C, constant and periodic, beside clocks and methods without a C."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from perdure.report import theme, wording
from perdure.report.axes import Axis
from perdure.report.curves import Curve, Level, curve_chart
from perdure.report.render import Figure, slug
from perdure.report.statistics import Interval
from perdure.studies.horizon import styles, words
from perdure.studies.horizon.claim import Condition
from perdure.studies.horizon.estimates import bounds, interval_note, run_interval
from perdure.studies.horizon.results import Results

LEVELS = (Condition("ppo"), Condition("ppo-undiscounted"), Condition("geometric", "countdown"))
SWEEPS = {"constant": "always C steps to go", "periodic": "countdown from C, repeated"}


def sweep_figures(results: Results) -> Iterator[Figure]:
    """Return one figure for each setting whose geometric method was deployed under several C."""
    for setting in results.grid.settings:
        found = [(kind, _sweep(results, setting, kind)) for kind in SWEEPS]
        curves = [_curve(kind, sweep) for kind, sweep in found if len(sweep) > 1]
        if not curves:
            continue
        values = {each: results.values(setting, each) for each in LEVELS}
        others = {each: run_interval(runs) for each, runs in values.items() if runs}
        levels = [_level(condition, interval) for condition, interval in others.items()]
        horizon = wording.whole(float(results.grid.steps))
        shown = [interval for _, sweep in found for interval in sweep.values()]
        note = f"{interval_note(shown, 'Bars')} An ended episode earns nothing more. Level lines: means."
        chart = curve_chart(curves, Axis("C: steps to go given to the policy"), Axis("mean return"), levels=levels)
        title = f"Return of {horizon} steps by C, geometric time-to-go"
        yield Figure(slug("return-by-c", setting), title, chart, note, words.setting(setting))


def _sweep(results: Results, setting: str, kind: str) -> dict[float, Interval]:
    row = results.grid.row(setting, "geometric")
    if row is None or row.key not in results.test:
        return {}
    runs = results.of(row)
    clocks = runs.filter(runs["clock_kind"] == kind).select("clock_steps", "clock").unique().sort("clock_steps")
    return {
        float(steps): run_interval(results.values(setting, Condition("geometric", clock)))
        for steps, clock in clocks.iter_rows()
    }


def _curve(kind: str, sweep: dict[float, Interval]) -> Curve:
    mean, lower, upper = (np.array(each) for each in zip(*map(bounds, sweep.values()), strict=True))
    style = theme.style(list(SWEEPS).index(kind) + 2)
    return Curve(SWEEPS[kind], np.array(list(sweep)), mean, style, lower, upper, marked=True, intervals="bars")


def _level(condition: Condition, interval: Interval) -> Level:
    counted = condition.clock == "countdown"
    label = words.rule("countdown") if counted else words.method(condition.method)
    style = theme.style(len(SWEEPS) + 2) if counted else styles.style(condition)
    return Level(label, float(interval.estimate), math.nan, math.nan, style)
