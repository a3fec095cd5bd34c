"""Return of the test horizon against C, constant and periodic, beside clocks and methods without a C."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from perdure.report import wording
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
        states = {results.start_states(setting, each.method) for each in (Condition("geometric"), *others)}
        note = f"{interval_note(shown, 'Bars')} Level lines: means. An ended episode earns nothing more. "
        note += words.start_states(states)
        chart = curve_chart(curves, Axis("C: steps to go given to the policy"), Axis("mean return"), levels=levels)
        title = f"Return of {horizon} steps by C, geometric time-to-go"
        yield Figure(slug("return-by-c", setting), title, chart, note, words.setting(setting))


def _sweep(results: Results, setting: str, kind: str) -> dict[float, Interval]:
    return {
        steps: run_interval(results.values(setting, Condition("geometric", clock)))
        for steps, clock in results.swept(setting, "geometric", kind).items()
    }


def _curve(kind: str, sweep: dict[float, Interval]) -> Curve:
    mean, lower, upper = (np.array(each) for each in zip(*map(bounds, sweep.values()), strict=True))
    style = styles.style(Condition("geometric"), list(SWEEPS).index(kind))
    return Curve(SWEEPS[kind], np.array(list(sweep)), mean, style, lower, upper, marked=True, intervals="bars")


def _level(condition: Condition, interval: Interval) -> Level:
    counted = condition.clock == "countdown"
    label = words.rule("countdown") if counted else words.method(condition.method)
    style = styles.style(condition, len(SWEEPS) if counted else 0)
    return Level(label, float(interval.estimate), math.nan, math.nan, style)
