"""The figures of the study: those of chapter 3 and appendix A of the thesis, and ours."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from statistics import fmean
from typing import Any

import numpy as np
import polars as pl

from perdure.report import charts, wording
from perdure.report.charts import (
    Axis,
    Curve,
    Figure,
    Level,
    Marker,
    Points,
    Spec,
    Style,
    curve_chart,
    layer,
    named,
    point_chart,
    row_size,
    slug,
)
from perdure.report.groups import failure_times
from perdure.stats import (
    FEWEST_FOR_INTERVAL,
    TRAINING_SEEDS,
    FloatArray,
    Interval,
    Units,
    estimate_interval,
    kaplan_meier,
    make_units,
    survival_interval,
    t_interval,
)
from studies.horizon.claims import MEASURES, Condition
from studies.horizon.results import VERDICTS, Results
from studies.horizon.tables import (
    CHOSEN,
    METHODS,
    PPO,
    SCORED,
    choice_table,
    condition_words,
    main_settings,
    mean_score,
    method_words,
    rule_words,
    scores,
    setting_words,
)

SEED = 0
"""Of the bootstrap's generator: the same tables, the same intervals."""
SIBLINGS = {"linear-random": "linear", "linear-10-workers": "linear"}
"""Methods of one color, told apart by shape and dash."""
UNDISCOUNTED, AVERAGE = Condition("ppo-undiscounted"), Condition("ppo-average-reward")
LINEAR, BEST = Condition("linear", "constant:500"), Condition("geometric", "best")
COUNTDOWN = Condition("geometric", "countdown")
FIGURE_3_2 = (PPO, UNDISCOUNTED, BEST, CHOSEN)
CONTROLS = (
    CHOSEN,
    Condition("geometric-fixed", "chosen"),
    Condition("random-horizon"),
    Condition("linear-random", "constant:500"),
    AVERAGE,
    PPO,
)
CLOCK_RULES = tuple(Condition("geometric", rule) for rule in ("best", "chosen", "value", "bandit"))
VERDICT_CONDITIONS = (
    *(PPO, UNDISCOUNTED, AVERAGE, Condition("random-horizon"), LINEAR, Condition("linear-random", "constant:500")),
    *(Condition("geometric", "constant:500"), CHOSEN, COUNTDOWN, Condition("geometric-fixed", "chosen")),
)
COLORS = {"holds": 2, "decays": 4, "fails silently": 3, "falls": 1, "diverges": 6, "never worked": 7, "cannot tell": 5}
"""Verdict to its place among the colors of `charts.style`."""
MECHANISM_METHODS = ("ppo", "ppo-undiscounted", "random-horizon", "linear", "geometric", "geometric-fixed")
SWEEPS = {"constant": "always C steps to go", "periodic": "countdown from C, repeated"}
FEWEST_RUNS = 5
"""Runs of a task that get an interval of the score: that of three would be wider than the figure."""
SO_FAR = "Return so far, divided by the steps so far; an ended episode earns nothing more."


def all_figures(results: Results) -> Iterator[Figure]:
    """Draw every figure for which there are tables."""
    settings = results.grid.settings
    yield from _score_figure(results)
    for setting in settings:
        yield from _training_horizon_figure(results, setting)
    yield from _return_figures(results)
    constant = partial(_clock_figure, kind="constant", name="figure-a-2")
    periodic = partial(_clock_figure, kind="periodic", name="figure-a-3")
    for draw in (_learning_figure, _sweep_figure, constant, periodic, _survival_figure, _verdict_figure):
        for setting in settings:
            yield from draw(results, setting)
    yield from _bias_figure(results)
    for setting in settings:
        yield from _mechanism_figures(results, setting)
    for measure in ("value error", "value variance"):
        yield from _critic_figure(results, measure)


def _start_states(results: Results, keys: Collection[tuple[str, Condition]]) -> str:
    counts = {results.start_states(setting, each.method) for setting, each in keys}
    least, most = min(counts), max(counts)
    number = wording.count(most, "start state") if least == most else f"{least} to {wording.count(most, 'start state')}"
    return f"Each training run: {number}."


def style(condition: Condition, variant: int = 0) -> Style:
    """Return color, dash and shape of a method, the same in every figure.

    Args:
        condition: The method; the optimistic choice of C is a variant of its own.
        variant: Of the same color, with another dash and shape.
    """
    name, first = SIBLINGS.get(condition.method, condition.method), list(METHODS)[:8]
    place = first.index(name) if name in first else len(first) - 1
    variant += name != condition.method or condition.clock == "best"
    other = charts.style(place + 3 + variant if variant else place)
    return replace(charts.style(place), dash=other.dash, shape=other.shape)


# Intervals and curves.


def _run_interval(values: Mapping[int, float]) -> Interval:
    """Return the mean over training runs with Student's t interval, as tables and claims have it."""
    return t_interval(Units(np.array([values[seed] for seed in sorted(values)]), TRAINING_SEEDS))


def _bounds(interval: Interval) -> tuple[float, float, float]:
    """Return (mean, lower, upper); nan bounds where there are too few training runs."""
    few = interval.count < FEWEST_FOR_INTERVAL
    lower, upper = (np.nan, np.nan) if few else (float(interval.lower), float(interval.upper))
    return float(interval.estimate), lower, upper


def _interval_note(intervals: Collection[Interval], what: str) -> str:
    """Return the kind of the intervals and the number of training runs as text."""
    many = [each for each in intervals if each.count >= FEWEST_FOR_INTERVAL]
    if not many:
        return f"No intervals: fewer than {FEWEST_FOR_INTERVAL} training runs."
    counts = sorted({each.count for each in many})
    runs = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    methods = " or ".join(dict.fromkeys(each.method for each in many))
    return f"{what}: pointwise 95 % intervals ({methods}), n = {runs} training runs."


def _curve(
    label: str, x: FloatArray, interval: Interval, look: Style, divisor: FloatArray | None = None, bands: bool = True
) -> Curve:
    """Return an interval as a curve; without bounds where there are too few training runs."""
    by = np.ones_like(x) if divisor is None else divisor
    few = interval.count < FEWEST_FOR_INTERVAL
    low, high = (None, None) if few else (interval.lower / by, interval.upper / by)
    return Curve(label, x, interval.estimate / by, look, low, high, intervals="band" if bands else "last")


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

    @cached_property
    def working(self) -> Interval:
        """Share of episodes without a failure so far (Kaplan-Meier); no bounds once an episode cannot be judged."""
        verdicts, steps = self.episodes["verdict"].to_list(), self.episodes["failed_step"].to_numpy()
        judged = self.episodes["steps to failure"].fill_null(0.0).to_numpy()
        whole = self.episodes["failed share"].fill_null(0.0).to_numpy() == 0.0
        without = whole[:, None] | (judged[:, None] > self.steps[None, :])
        interval = survival_interval(without, self.episodes["train_seed"], np.random.default_rng(SEED))
        times, shares = kaplan_meier(*failure_times(verdicts, steps))
        estimate = np.concatenate([[1.0], shares])[np.searchsorted(times, self.steps, side="right")]
        watched = np.where(self.episodes["failed share"].is_null().to_numpy(), steps, self.steps[-1] + 1).min()
        low, high = (np.where(self.steps < watched, bound, np.nan) for bound in (interval.lower, interval.upper))
        return replace(interval, estimate=estimate, lower=low, upper=high)


def _deployed(results: Results, setting: str, conditions: Sequence[Condition]) -> list[_Deployed]:
    """Return the conditions that are evaluated."""
    found = [(condition, results.deployed(setting, condition)) for condition in conditions]
    return [_Deployed(c, e, np.array(e["curve_steps"][0], np.float64)) for c, e in found if not e.is_empty()]


def _steps_axis(found: Sequence[_Deployed]) -> Axis:
    return Axis("steps since the reset", log=True, low=float(found[0].steps[0]), high=float(found[0].steps[-1]))


def _episodes(found: Sequence[_Deployed]) -> str:
    return wording.sample([len(each.episodes) for each in found], "episode")


def _markers(found: Sequence[_Deployed]) -> tuple[Marker, ...]:
    low, high = found[0].steps[0], found[0].steps[-1]
    horizons = sorted({at for each in found if low < (at := float(each.episodes["train_horizon"][0])) < high})
    return tuple(Marker(at, f"longest training horizon, {wording.whole(at)} steps") for at in horizons)


def _reward_figure(
    setting: str, found: Sequence[_Deployed], curves: Sequence[Curve], name: str, title: str, bars: str
) -> Figure:
    """Return a figure of the mean reward per step so far."""
    chart = curve_chart(
        curves, _steps_axis(found), Axis(f"mean reward per step so far ({_episodes(found)})"), markers=_markers(found)
    )
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
    others, highest = _deployed(results, setting, (COUNTDOWN, PPO, UNDISCOUNTED)), max(clocks) or 1.0
    drawn = [
        (f"C = {wording.whole(c)}", e, charts.ordered_style(c / highest)) for c, e in zip(clocks, sweep, strict=True)
    ]
    for place, each in enumerate(others, 1):
        label = "countdown" if each.condition == COUNTDOWN else condition_words(each.condition)
        drawn.append((label, each, replace(charts.style(place), color=charts.INK)))
    curves = [_curve(label, e.steps, e.returns, look, e.steps, bands=False) for label, e, look in drawn]
    title = f"Geometric time-to-go, {wording.clock(kind, 'C')}"
    yield _reward_figure(setting, [*sweep, *others], curves, name, title, "Bars at the right")


def _survival_figure(results: Results, setting: str) -> Iterator[Figure]:
    """Draw the share of episodes that have not failed, for the thesis' four methods and the average reward."""
    found = _deployed(results, setting, (PPO, UNDISCOUNTED, AVERAGE, LINEAR, CHOSEN))
    if not found:
        return
    curves = [_curve(condition_words(e.condition), e.steps, e.working, style(e.condition), bands=False) for e in found]
    y = Axis(f"share of episodes that have not failed ({_episodes(found)})", percent=True)
    note = (
        "A failure: a fall, a divergence, or to the end a score against its own training below 0.75 "
        "(Kaplan-Meier). A policy that never worked, or earns too little from its first "
        f"window on, has failed from the start. {_interval_note([e.working for e in found], 'Bars at the right')}"
    )
    chart = curve_chart(curves, _steps_axis(found), y, markers=_markers(found), steps=True)
    yield Figure(slug("survival", setting), "Episodes that have not failed", chart, note, setting_words(setting))


def _learning_figure(results: Results, setting: str) -> Iterator[Figure]:
    """Draw figure A-1: returns of the training episodes with and without a linear time-to-go."""
    mine = results.learning.filter(pl.col("setting") == setting)
    found = {
        name: part
        for name in ("ppo", "linear", "linear-10-workers")
        if len(part := mine.filter(pl.col("method") == name))
    }
    if not {"ppo", "linear"} <= set(found):
        return
    curves, intervals, counts = [], [], []
    for name, part in found.items():
        runs = part.partition_by("train_seed", maintain_order=True)
        x = np.linspace(0.0, float(part["step"].max() or 1.0), 51)[1:]  # type: ignore[arg-type]
        rows = [
            run["return"].to_numpy()[np.searchsorted(run["step"], x * 0.999, side="left").clip(0, len(run) - 1)]
            for run in runs
        ]
        interval = estimate_interval(Units(np.stack(rows), TRAINING_SEEDS), np.random.default_rng(SEED))
        curves.append(_curve(method_words(name), x, interval, style(Condition(name))))
        intervals.append(interval)
        counts.append(len(runs))
    note = "Sampled actions, as in training. To the linear methods the horizon is also an end. "
    note += _interval_note(intervals, "Bands")
    y = Axis(f"mean return of training episodes ({wording.sample(counts, 'training run')})")
    chart = curve_chart(curves, Axis("training steps"), y)
    yield Figure(slug("figure-a-1", setting), "Training returns", chart, note, setting_words(setting))


def _sweep_figure(results: Results, setting: str) -> Iterator[Figure]:
    """Draw the return by C, constant and periodic, beside clocks and methods without a C."""

    def interval(condition: Condition) -> Interval | None:
        values = results.values(setting, condition)
        return _run_interval(values) if values else None

    curves, shown = [], list[Interval]()
    for place, (kind, label) in enumerate(SWEEPS.items()):
        clocks = results.swept(setting, "geometric", kind)
        sweep = [found for clock in clocks.values() if (found := interval(Condition("geometric", clock)))]
        shown += sweep
        if len(sweep) > 1:
            mean, lower, upper = (np.array(each) for each in zip(*map(_bounds, sweep), strict=True))
            look = style(Condition("geometric"), place)
            curves.append(Curve(label, np.array(list(clocks)), mean, look, lower, upper, marked=True, intervals="bars"))
    if not curves:
        return
    others = {each: found for each in (PPO, UNDISCOUNTED, COUNTDOWN) if (found := interval(each))}
    levels = [
        Level(
            rule_words("countdown") if each == COUNTDOWN else method_words(each.method),
            float(found.estimate),
            math.nan,
            math.nan,
            style(each, len(SWEEPS) if each == COUNTDOWN else 0),
        )
        for each, found in others.items()
    ]
    note = f"{_interval_note(shown, 'Bars')} Level lines: means. An ended episode earns nothing more. "
    note += _start_states(results, [(setting, each) for each in (CHOSEN, *others)])
    chart = curve_chart(curves, Axis("C: steps to go given to the policy"), Axis("mean return"), levels=levels)
    title = f"Return of {wording.whole(float(results.grid.steps))} steps by C, geometric time-to-go"
    yield Figure(slug("return-by-c", setting), title, chart, note, setting_words(setting))


# Points by setting.


def _points(
    label: str,
    look: Style,
    intervals: Mapping[int, tuple[float, float, float]],
    rings: Mapping[int, Sequence[float]] | None = None,
) -> Points:
    """Return one condition's points: (mean, lower, upper) by row, and the training runs as rings."""
    mean, lower, upper = (np.array(each) for each in zip(*intervals.values(), strict=True))
    members = () if rings is None else ([list(rings.get(row, ())) for row in intervals],)
    return Points(label, list(intervals), mean, look, lower, upper, *members)


def _score_figure(results: Results) -> Iterator[Figure]:
    """Draw the score of the whole test horizon on the tasks of the mean, and the mean."""
    names = main_settings(results)
    values = {(name, each): found for name in names for each in SCORED if (found := scores(results, name, each))}
    if not values:
        return
    means = {each: mean for each in SCORED if (mean := mean_score(results, each)) is not None}
    names = tuple(name for name in names if any(name == key[0] for key in values))
    points = []
    for each in SCORED:
        shown: dict[int, tuple[float, float, float]] = {}
        rings: dict[int, list[float]] = {}
        if each in means:
            shown[0] = means[each].estimate, means[each].lower, means[each].upper
        for row, name in enumerate(names, 1 if means else 0):
            if runs := values.get((name, each)):
                few = len(runs) < FEWEST_RUNS
                shown[row] = (fmean(runs.values()), np.nan, np.nan) if few else _bounds(_run_interval(runs))
                rings[row] = list(runs.values())
        if shown:
            points.append(_points(condition_words(each), style(each), shown, rings))
    intervals = [_run_interval(found) for found in values.values() if len(found) >= FEWEST_RUNS]
    note = (
        "Return minus that of an idle robot, as a share of that of a published policy that never fails. An early fall "
        "scores near 0 too. Hollow: training runs. "
        f"{_interval_note(intervals, 'Bars')} None for fewer than {FEWEST_RUNS} runs of a task. "
        f"{_start_states(results, list(values))}"
    )
    rows = [f"mean of {len(names)} tasks"] * bool(means) + [setting_words(name) for name in names]
    chart = point_chart(rows, points, Axis("score (0: idle robot, 1: published policy)"), charts.WIDE)
    yield Figure("score", f"Score against a published policy over {results.grid.steps:,} steps", chart, note, wide=True)


def _return_figures(results: Results) -> Iterator[Figure]:
    """Draw figure 3-2, the controls, the rules that choose C: return of the test horizon by setting."""
    title = f"Return of {wording.whole(float(results.grid.steps))} steps"
    yield from _return_figure(results, "figure-3-2", title, FIGURE_3_2)
    about, label = "C is cross-validated.", lambda each: method_words(each.method)
    yield from _return_figure(results, "controls", f"{title}: the method and its controls", CONTROLS, label, about)
    about, label = "Geometric time-to-go.", lambda each: rule_words(each.clock)
    yield from _return_figure(
        results, "rules", f"{title} by how C was chosen", CLOCK_RULES, label, about, by_place=True
    )


def _return_figure(
    results: Results,
    name: str,
    title: str,
    conditions: Sequence[Condition],
    label: Callable[[Condition], str] = condition_words,
    about: str = "",
    by_place: bool = False,
) -> Iterator[Figure]:
    names: Sequence[str] = results.grid.settings
    values = {(each, c): found for each in names for c in conditions if (found := results.values(each, c))}
    names = [each for each in names if any(each == setting for setting, _ in values)]
    if not names:
        return
    published = {each: rate for each in names if math.isfinite(rate := results.published_rate(each))}
    without = [setting_words(each) for each in names if each not in published] if published else []
    names = list(published) or names
    scale = {each: published[each] * results.grid.steps if published else 1.0 for each in names}
    scaled = {
        key: {seed: value / scale[key[0]] for seed, value in found.items()}
        for key, found in values.items()
        if key[0] in scale
    }
    intervals = {key: _run_interval(found) for key, found in scaled.items()}
    points = []
    for place, each in enumerate(conditions):
        rows = {row: (setting, each) for row, setting in enumerate(names) if (setting, each) in scaled}
        if rows:
            look = charts.style(place) if by_place else style(each)
            means = {row: _bounds(intervals[key]) for row, key in rows.items()}
            points.append(
                _points(label(each), look, means, {row: list(scaled[key].values()) for row, key in rows.items()})
            )
    note = f"{about} " if about else ""
    note += f"Hollow: training runs. {_interval_note(list(intervals.values()), 'Bars')}"
    note += f" {_start_states(results, list(scaled))}"
    note += " 1: the reward rate of a published policy in episodes of 1,000 steps, kept up." if published else ""
    note += f" Not shown, for want of a published policy: {', '.join(without)}." if without else ""
    axis = Axis("share of a published policy's reward" if published else "return")
    yield Figure(name, title, point_chart([*map(setting_words, names)], points, axis, charts.WIDE), note, wide=True)


def _bias_figure(results: Results) -> Iterator[Figure]:
    """Draw the optimistic bias of showing the best C of a sweep."""
    choices = choice_table(results)
    if choices.is_empty():
        return
    bias = choices.filter((pl.col("kind") == "constant") & (pl.col("method") == "geometric"))
    if bias.is_empty():
        return
    scale = bias["cross-validated"].abs().to_numpy()
    columns = [bias[name].to_numpy() / np.where(scale > 0.0, scale, 1.0) for name in ("bias", "lower", "upper")]
    points = [Points("bias", range(len(bias)), columns[0], charts.style(0), columns[1], columns[2])]
    axis = Axis("best C minus cross-validated C, as a share of the latter's return")
    note = (
        "Best C: the highest mean return on the start states that are reported. Cross-validated C: chosen by the other "
        "training runs on other start states. Bars: 95 % intervals (paired t) over training runs, n = "
        f"{int(bias['runs'].min() or 0)} to {int(bias['runs'].max() or 0)}."  # type: ignore[arg-type]
    )
    chart = point_chart([setting_words(setting) for setting in bias["setting"]], points, axis)
    yield Figure("choice-bias", "What choosing C on the reported episodes adds", chart, note)


def _critic_figure(results: Results, measure: str) -> Iterator[Figure]:
    """Draw error or unexplained variance of the critic, by setting."""
    found = {
        (setting, method): _run_interval(values)
        for setting in results.grid.settings
        for method in MECHANISM_METHODS
        if (values := results.values(setting, Condition(method), measure))
    }
    names = [setting for setting in results.grid.settings if any(setting == each for each, _ in found)]
    points = []
    for method in dict.fromkeys(method for _, method in found):
        rows = {k: _bounds(found[name, method]) for k, name in enumerate(names) if (name, method) in found}
        points.append(_points(method_words(method), style(Condition(method)), rows))
    if points:
        note = f"{MEASURES[measure].capitalize()}. {_interval_note(list(found.values()), 'Bars')}"
        chart = point_chart([*map(setting_words, names)], points, Axis(measure), charts.WIDE)
        yield Figure(slug(measure), f"The critic: {measure}", chart, note, wide=True)


def _mechanism_figures(results: Results, setting: str) -> Iterator[Figure]:
    """Draw reward against steps to go, and the dependence of the action on C."""
    axes = Axis("steps to go of the training horizon"), Axis("mean reward per step")
    yield from _mechanism_figure(results, setting, "reward", axes, "reward-to-go", "Reward by steps to go")
    axes = (
        Axis("C: steps to go given to the policy"),
        Axis("change of the action, as a share of the action box", low=0.0),
    )
    title = "Change of the action with C instead of 500 steps to go"
    yield from _mechanism_figure(results, setting, "change", axes, "action-dependence", title)


def _mechanism_figure(
    results: Results, setting: str, measure: str, axes: tuple[Axis, Axis], name: str, title: str
) -> Iterator[Figure]:
    curves, intervals = list[Curve](), list[Interval]()
    mine = results.mechanism.filter((pl.col("setting") == setting) & (pl.col("measure") == measure))
    for method in MECHANISM_METHODS:
        part = mine.filter(pl.col("method") == method)
        if part.is_empty():
            continue
        wide = part.pivot(on="train_seed", index="at", values="result").drop_nulls().sort("at")
        units = Units(np.ascontiguousarray(wide.drop("at").to_numpy().T), TRAINING_SEEDS)
        interval = estimate_interval(units, np.random.default_rng(SEED))
        if axes[1].low is not None:
            interval = replace(interval, lower=np.maximum(interval.lower, axes[1].low))
        x = wide["at"].to_numpy().astype(np.float64)
        curves.append(_curve(method_words(method), x, interval, style(Condition(method))))
        intervals.append(interval)
    if curves:
        note = "Short rollouts of the mean action, as far as every training run came. "
        note += _interval_note(intervals, "Bands")
        yield Figure(slug(name, setting), title, curve_chart(curves, *axes), note, setting_words(setting))


def _verdict_figure(results: Results, setting: str) -> Iterator[Figure]:
    """Draw what became of the episodes of each method, as stacked bars."""
    rows: list[dict[str, Any]] = []
    counts = set[int]()
    for condition in VERDICT_CONDITIONS:
        episodes = results.deployed(setting, condition)
        if episodes.is_empty():
            continue
        counts.add(len(episodes))
        for order, verdict in enumerate(VERDICTS):
            by_run = episodes.group_by("train_seed").agg((pl.col("verdict") == verdict).mean())
            share = float(by_run.sort("train_seed")["verdict"].mean() or 0.0)  # type: ignore[arg-type]
            name = condition_words(condition)
            rows.append({"method": name, "verdict": verdict, "share": float(f"{share:.6g}"), "order": order})
    if rows:
        note = f"Share of the test episodes of each method; {wording.sample(sorted(counts), 'episode')}. "
        note += "Training runs count alike."
        chart = _stacked(rows)
        yield Figure(slug("verdicts", setting), "What became of the episodes", chart, note, setting_words(setting))


def _stacked(rows: Sequence[Mapping[str, Any]]) -> Spec:
    names = list(dict.fromkeys(row["method"] for row in rows))
    drawn = [dict(row) for row in rows if row["share"] > 0]
    shown = [verdict for verdict in VERDICTS if any(row["verdict"] == verdict for row in drawn)]
    plot, height = row_size(names, 1, charts.WIDTH)
    colors = {"domain": shown, "range": [charts.style(COLORS[verdict]).color for verdict in shown]}
    share = {"field": "share", "type": "quantitative"}
    axis = {"labelExpr": "format(100 * datum.value, '~g') + ' %'", "grid": False}
    bars = layer(
        drawn,
        "bar",
        {},
        y=named("method", title=None, scale={"domain": names, "paddingInner": 0.3}),
        x=share | {"title": "share of episodes", "scale": {"domain": [0.0, 1.0]}, "axis": axis},
        color=named("verdict", title=None, scale=colors),
        order={"field": "order", "type": "quantitative"},
        tooltip=[named("verdict"), share | {"format": ".1%"}],
    )
    return {"layer": [bars], "width": plot, "height": height}
