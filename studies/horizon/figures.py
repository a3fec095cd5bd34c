"""The figures of the study: those of chapter 3 and appendix A of the thesis, and ours."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Literal

import numpy as np
import polars as pl

from perdure.report import charts, wording
from perdure.report.charts import Axis, Curve, Figure, Marker, Points, Style, curve_chart, point_chart, slug
from perdure.stats import (
    FEWEST_FOR_INTERVAL,
    TRAINING_SEEDS,
    FloatArray,
    Interval,
    Units,
    estimate_interval,
    make_units,
    t_interval,
)
from studies.horizon.claims import Condition
from studies.horizon.grid import METHODS
from studies.horizon.results import Results
from studies.horizon.tables import CHOSEN, PPO, condition_words, setting_words

SEED = 0
"""Of the bootstrap's generator: the same tables, the same intervals."""
SIBLINGS = {"linear-random": "linear", "linear-10-workers": "linear"}
"""Methods of one color, told apart by shape and dash."""
UNDISCOUNTED = Condition("ppo-undiscounted")
BEST = Condition("geometric", "best")
COUNTDOWN = Condition("geometric", "countdown")
FIGURE_3_2 = (PPO, UNDISCOUNTED, BEST, CHOSEN)
MECHANISM_METHODS = ("ppo", "ppo-undiscounted", "random-horizon", "linear", "geometric", "geometric-fixed")
SO_FAR = "Return so far, divided by the steps so far; an ended episode earns nothing more."


def all_figures(results: Results) -> Iterator[Figure]:
    """Draw every figure for which there are tables."""
    settings = results.grid.settings
    for setting in settings:
        yield from _training_horizon_figure(results, setting)
    yield from _return_figure(results)
    constant = partial(_clock_figure, kind="constant", name="figure-a-2")
    periodic = partial(_clock_figure, kind="periodic", name="figure-a-3")
    for draw in (_learning_figure, constant, periodic):
        for setting in settings:
            yield from draw(results, setting)
    yield from _critic_figure(results)


def _start_states(results: Results, keys: Collection[tuple[str, Condition]]) -> str:
    counts = {int(results.of(setting, each.method)["episodes"].min()) for setting, each in keys}  # type: ignore[arg-type]
    number = wording.count(max(counts), "start state")
    if len(counts) > 1:
        number = f"{min(counts)} to {number}"
    return f"Each training run: {number}."


def style(condition: Condition) -> Style:
    """Return color, dash and shape of a method, the same in every figure.

    The optimistic choice of C has the color of its method, and another dash and shape.
    """
    name = SIBLINGS.get(condition.method, condition.method)
    place = min(list(METHODS).index(name), 7) if name in METHODS else 7
    look = charts.style(place)
    if name != condition.method or condition.clock == "best":
        other = charts.style(place + 4)
        look = replace(look, dash=other.dash, shape=other.shape)
    return look


# Intervals and curves.


def _interval_note(intervals: Collection[Interval], what: str) -> str:
    """Return the kind of the intervals and the number of their units as text."""
    many = [each for each in intervals if each.count >= FEWEST_FOR_INTERVAL]
    if not many:
        return f"No intervals: fewer than {FEWEST_FOR_INTERVAL} training runs."
    counts = sorted({each.count for each in many})
    runs = str(counts[-1])
    if len(counts) > 1:
        runs = f"{counts[0]} to {counts[-1]}"
    units = "training runs" if many[0].label == TRAINING_SEEDS else "start states of one training run"
    fewer = ""
    if len(many) < len(intervals):
        fewer = "; none where there are fewer"
    methods = " or ".join(dict.fromkeys(each.method for each in many))
    return f"{what}: pointwise 95 % intervals ({methods}), n = {runs} {units}{fewer}."


def _curve(
    label: str, x: FloatArray, interval: Interval, look: Style, divisor: FloatArray | None = None, bands: bool = True
) -> Curve:
    """Return an interval as a curve; without bounds where there are too few training runs."""
    by = np.ones_like(x) if divisor is None else divisor
    kind: Literal["band", "last"] = "band" if bands else "last"
    return Curve(label, x, interval.estimate / by, look, interval.lower / by, interval.upper / by, intervals=kind)


@dataclass(frozen=True, eq=False)
class _Deployed:
    """The test episodes of a condition, with curves over the recorded steps."""

    condition: Condition
    episodes: pl.DataFrame
    steps: FloatArray

    @cached_property
    def returns(self) -> Interval:
        """Mean return so far."""
        curves = np.array(self.episodes["curve"].to_list(), np.float64)
        return estimate_interval(make_units(curves, self.episodes["train_seed"]), np.random.default_rng(SEED))


def _deployed(results: Results, setting: str, conditions: Sequence[Condition]) -> list[_Deployed]:
    """Return the conditions that are evaluated."""
    found = [(condition, results.deployed(setting, condition)) for condition in conditions]
    return [_Deployed(c, e, np.array(e["curve_steps"][0], np.float64)) for c, e in found if not e.is_empty()]


def _markers(found: Sequence[_Deployed]) -> tuple[Marker, ...]:
    low = found[0].steps[0]
    high = found[0].steps[-1]
    horizons = {float(each.episodes["train_horizon"][0]) for each in found}
    return tuple(
        Marker(at, f"longest training horizon, {wording.whole(at)} steps") for at in sorted(horizons) if low < at < high
    )


def _reward_figure(
    setting: str, found: Sequence[_Deployed], curves: Sequence[Curve], name: str, title: str, bars: str
) -> Figure:
    """Return a figure of the mean reward per step so far."""
    x = Axis("steps since the reset", log=True, low=float(found[0].steps[0]), high=float(found[0].steps[-1]))
    episodes = wording.sample([len(each.episodes) for each in found], "episode")
    chart = curve_chart(curves, x, Axis(f"mean reward per step so far ({episodes})"), markers=_markers(found))
    note = f"{SO_FAR} {_interval_note([each.returns for each in found], bars)}"
    return Figure(slug(name, setting), title, chart, note, setting_words(setting))


def _training_horizon_figure(results: Results, setting: str) -> Iterator[Figure]:
    """Draw figure 3-1: trained in episodes of 200 steps, and of 1,000."""
    found = _deployed(results, setting, (Condition("ppo-short"), PPO))
    if len(found) == 2:
        curves = [_curve(condition_words(e.condition), e.steps, e.returns, style(e.condition), e.steps) for e in found]
        title = "Trained in episodes of 200 steps and of 1,000 steps"
        yield _reward_figure(setting, found, curves, "figure-3-1", title, "Bands")


def _clock_figure(results: Results, setting: str, kind: str, name: str) -> Iterator[Figure]:
    """Draw figure A-2 or A-3: every C, constant or as a repeated countdown, with the countdown and the baselines."""
    clocks = results.swept(setting, "geometric", kind)
    if not clocks:
        return
    sweep = _deployed(results, setting, [Condition("geometric", clock) for clock in clocks.values()])
    others = _deployed(results, setting, (COUNTDOWN, PPO, UNDISCOUNTED))
    highest = max(clocks) or 1.0
    curves = []
    for steps, each in zip(clocks, sweep, strict=True):
        look = charts.ordered_style(steps / highest)
        curves.append(_curve(f"C = {wording.whole(steps)}", each.steps, each.returns, look, each.steps, bands=False))
    for place, each in enumerate(others, 1):
        label = "countdown" if each.condition == COUNTDOWN else condition_words(each.condition)
        look = replace(charts.style(place), color=charts.INK)
        curves.append(_curve(label, each.steps, each.returns, look, each.steps, bands=False))
    title = f"Geometric time-to-go, {wording.clock(kind, 'C')}"
    yield _reward_figure(setting, [*sweep, *others], curves, name, title, "Bars at the right")


def _learning_figure(results: Results, setting: str) -> Iterator[Figure]:
    """Draw figure A-1: returns of the training episodes with and without a linear time-to-go."""
    mine = results.learning.filter(pl.col("setting") == setting)
    if not {"ppo", "linear"} <= set(mine["method"]):
        return
    curves = []
    intervals = []
    for name in ("ppo", "linear", "linear-10-workers"):
        part = mine.filter(pl.col("method") == name)
        if part.is_empty():
            continue
        runs = part.partition_by("train_seed", maintain_order=True)
        x = np.linspace(0.0, float(part["step"].max() or 1.0), 51)[1:]  # type: ignore[arg-type]
        rows = [
            run["return"].to_numpy()[np.searchsorted(run["step"], x * 0.999, side="left").clip(0, len(run) - 1)]
            for run in runs
        ]
        interval = estimate_interval(Units(np.stack(rows), TRAINING_SEEDS), np.random.default_rng(SEED))
        curves.append(_curve(condition_words(Condition(name)), x, interval, style(Condition(name))))
        intervals.append(interval)
    note = "Sampled actions, as in training. To the linear methods the horizon is also an end. "
    note += _interval_note(intervals, "Bands")
    y = Axis(f"mean return of training episodes ({wording.sample([each.count for each in intervals], 'training run')})")
    chart = curve_chart(curves, Axis("training steps"), y)
    yield Figure(slug("figure-a-1", setting), "Training returns", chart, note, setting_words(setting))


# Points by setting.


def _setting_figure(
    values: Mapping[tuple[str, Condition], Mapping[int, float]],
    name: str,
    title: str,
    axis: str,
    note: str,
    rings: bool,
) -> Figure:
    """Draw means over training runs, a row for each setting; with `rings` the runs too.

    `values` are by setting and condition; the note on intervals replaces "{intervals}" in `note`.
    """
    names = list(dict.fromkeys(setting for setting, _ in values))
    intervals = {
        key: t_interval(Units(np.array([found[seed] for seed in sorted(found)]), TRAINING_SEEDS))
        for key, found in values.items()
    }
    points = []
    for each in dict.fromkeys(condition for _, condition in values):
        keys = {row: (setting, each) for row, setting in enumerate(names) if (setting, each) in values}
        mine = [intervals[key] for key in keys.values()]
        mean, lower, upper = np.array([(found.estimate, *found.last()) for found in mine]).T
        runs = None
        if rings:
            runs = [list(values[key].values()) for key in keys.values()]
        points.append(Points(condition_words(each), list(keys), mean, style(each), lower, upper, runs))
    chart = point_chart([*map(setting_words, names)], points, Axis(axis), charts.WIDE)
    note = note.format(intervals=_interval_note(list(intervals.values()), "Bars"))
    return Figure(name, title, chart, note, wide=True)


def _return_figure(results: Results) -> Iterator[Figure]:
    """Draw figure 3-2: return of the test horizon by setting, as far as there is a published policy."""
    shares = {}
    for setting in results.grid.settings:
        rate = results.published_rate(setting)
        if not math.isfinite(rate):
            continue
        for condition in FIGURE_3_2:
            found = results.values(setting, condition)
            if found:
                whole = rate * results.grid.steps
                shares[setting, condition] = {seed: value / whole for seed, value in found.items()}
    if shares:
        title = f"Return of {wording.whole(float(results.grid.steps))} steps"
        note = (
            f"Hollow: training runs. {{intervals}} {_start_states(results, list(shares))} "
            "1: the reward rate of a published policy in episodes of 1,000 steps, kept up."
        )
        yield _setting_figure(shares, "figure-3-2", title, "share of a published policy's reward", note, rings=True)


def _critic_figure(results: Results) -> Iterator[Figure]:
    """Draw the unexplained variance of the critic, by setting."""
    measure = "value variance"
    unexplained = {}
    for setting in results.grid.settings:
        for condition in map(Condition, MECHANISM_METHODS):
            values = results.values(setting, condition, measure)
            if values:
                unexplained[setting, condition] = values
    if unexplained:
        note = "Share of the variance of the returns to go that the value does not explain. {intervals}"
        title = "What the critic leaves unexplained"
        yield _setting_figure(unexplained, slug(measure), title, "unexplained share of variance", note, rings=False)
