"""Points for each setting: figure 3-2, the controls, the bias of the optimistic choice, rules without a sweep."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
import polars as pl

from perdure.report import theme, wording
from perdure.report.axes import Axis
from perdure.report.render import Figure
from perdure.report.rows import Points, point_chart
from perdure.report.statistics import Interval
from perdure.report.theme import Style
from perdure.studies.horizon import styles, words
from perdure.studies.horizon.claim import Condition
from perdure.studies.horizon.estimates import bounds, interval_note, run_interval
from perdure.studies.horizon.results import Results

FIGURE_3_2 = (
    Condition("ppo"),
    Condition("ppo-undiscounted"),
    Condition("geometric", "best"),
    Condition("geometric", "chosen"),
)
CONTROLS = (
    Condition("geometric-fixed", "chosen"),
    Condition("random-horizon"),
    Condition("linear-random", "constant:500"),
    Condition("ppo-average-reward"),
    Condition("ppo"),
)
RULES = tuple(Condition("geometric", rule) for rule in ("best", "chosen", "value", "bandit"))


def return_figures(results: Results) -> Iterator[Figure]:
    """Draw figure 3-2, the controls and the rules that choose C: return of the whole test horizon by setting."""
    title = f"Return of {wording.whole(float(results.grid.steps))} steps"
    chosen = results.constant.clock == "chosen"
    if chosen:
        yield from _figure(results, "figure-3-2", title, FIGURE_3_2)
    about = f"C {'is cross-validated' if chosen else '= 500'}."
    controls = (results.constant, *CONTROLS)
    yield from _figure(results, "controls", f"{title}: the method and its controls", controls, _method, about)
    if chosen:
        about, by_rule = "Geometric time-to-go.", f"{title} by how C was chosen"
        yield from _figure(results, "rules", by_rule, RULES, _rule, about, style=_place(RULES))
    gammas = [Condition(row.method) for row in results.grid.rows if row.gamma is not None]
    if gammas:
        compared = (Condition("geometric", "chosen"), Condition("ppo"), *dict.fromkeys(gammas))
        by_discount = f"{title} by discount"
        yield from _figure(results, "gamma", by_discount, compared, needs=gammas[0].method, style=_place(compared))


def _method(condition: Condition) -> str:
    return words.method(condition.method)


def _rule(condition: Condition) -> str:
    return words.rule(condition.clock)


def _place(conditions: Sequence[Condition]) -> Callable[[Condition], Style]:
    return lambda condition: theme.style(conditions.index(condition))


def _figure(
    results: Results,
    name: str,
    title: str,
    conditions: Sequence[Condition],
    label: Callable[[Condition], str] = words.condition,
    about: str = "",
    needs: str = "",
    style: Callable[[Condition], Style] = styles.style,
) -> Iterator[Figure]:
    values = {
        (setting, condition): found
        for setting in results.grid.settings
        for condition in conditions
        if (found := results.values(setting, condition))
    }
    if needs:
        having = {setting for setting, condition in values if condition.method == needs}
        values = {key: found for key, found in values.items() if key[0] in having}
    settings = [each for each in results.grid.settings if any(setting == each for setting, _ in values)]
    if not settings:
        return
    published = {each: scale for each in settings if (scale := return_scale(results, each)) is not None}
    without = [words.setting(each) for each in settings if each not in published] if published else []
    settings, scales = (list(published), published) if published else (settings, dict.fromkeys(settings, 1.0))
    values = {key: found for key, found in values.items() if key[0] in scales}
    intervals = {key: run_interval(_scaled(found, scales[key[0]])) for key, found in values.items()}
    points = [
        _points(label(condition), condition, style(condition), settings, values, scales, intervals)
        for condition in conditions
        if any(each == condition for _, each in values)
    ]
    axis = Axis("share of a published policy's reward" if published else "return")
    note = f"{about} " if about else ""
    note += f"Hollow: training runs. {interval_note(list(intervals.values()), 'Bars')}"
    note += " " + words.start_states({results.start_states(setting, each.method) for setting, each in values})
    note += " 1: the reward rate of a published policy in episodes of 1,000 steps, kept up." if published else ""
    note += f" Not shown, for want of a published policy: {', '.join(without)}." if without else ""
    chart = point_chart([words.setting(setting) for setting in settings], points, axis, theme.WIDE)
    yield Figure(name, title, chart, note, wide=True)


def _points(
    label: str,
    condition: Condition,
    style: Style,
    settings: Sequence[str],
    values: Mapping[tuple[str, Condition], Mapping[int, float]],
    scales: Mapping[str, float],
    intervals: Mapping[tuple[str, Condition], Interval],
) -> Points:
    rows = [row for row, setting in enumerate(settings) if (setting, condition) in values]
    found = [bounds(intervals[settings[row], condition]) for row in rows]
    mean, lower, upper = (np.array(each) for each in zip(*found, strict=True))
    rings = [list(_scaled(values[settings[row], condition], scales[settings[row]]).values()) for row in rows]
    return Points(label, rows, mean, style, lower, upper, rings)


def return_scale(results: Results, setting: str) -> float | None:
    """Return what a published policy would earn over the test horizon; None where none is known."""
    for row in results.grid.rows:
        if row.setting == setting and row.key in results.test:
            rate = float(results.test[row.key].frame["level_rate"][0])
            return rate * results.grid.steps if np.isfinite(rate) else None
    return None


def _scaled(values: Mapping[int, float], scale: float) -> dict[int, float]:
    return {seed: value / scale for seed, value in values.items()}


def bias_figure(bias: pl.DataFrame) -> Iterator[Figure]:
    """Draw the optimistic bias of showing the best C of a sweep."""
    if bias.is_empty():
        return
    names = [words.setting(setting) for setting in bias["setting"]]
    scale = bias["cross-validated"].abs().to_numpy()
    columns = [bias[name].to_numpy() / np.where(scale > 0.0, scale, 1.0) for name in ("bias", "lower", "upper")]
    points = [Points("bias", range(len(names)), columns[0], theme.style(0), columns[1], columns[2])]
    axis = Axis("best C minus cross-validated C, as a share of the latter's return")
    note = (
        "Best C: the highest mean return on the start states that are reported. Cross-validated C: chosen by the other "
        "training runs on other start states. Bars: 95 % intervals (paired t) over training runs, n = "
        f"{int(bias['runs'].min() or 0)} to {int(bias['runs'].max() or 0)}."  # type: ignore[arg-type]
    )
    chart = point_chart(names, points, axis)
    yield Figure("choice-bias", "What choosing C on the reported episodes adds", chart, note)
