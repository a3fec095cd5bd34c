"""The main figure: the gain over an idle robot, averaged over tasks and by task, with every training run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from statistics import fmean

import numpy as np

from perdure.report import theme
from perdure.report.axes import Axis
from perdure.report.render import Figure
from perdure.report.rows import Points, point_chart
from perdure.studies.horizon import styles, words
from perdure.studies.horizon.across_tasks import MeanGain, conditions, gains, mean_gains, settings
from perdure.studies.horizon.claim import Condition
from perdure.studies.horizon.estimates import bounds, interval_note, run_interval
from perdure.studies.horizon.results import Results

NAME = "gain"
FEWEST = 5
"""Runs of a task that get an interval: that of three would be wider than the figure."""


def gain_figure(results: Results) -> Iterator[Figure]:
    """Draw the gain of the whole test horizon on the tasks of the mean, and the mean."""
    compared = conditions(results)
    values = {
        (setting, each): found
        for setting in settings(results)
        for each in compared
        if (found := gains(results, setting, each))
    }
    if not values:
        return
    means = {each.condition: each for each in mean_gains(results)}
    names = [setting for setting in settings(results) if any(setting == key[0] for key in values)]
    shown = [each for each in compared if any(each == key[1] for key in values)]
    head = [f"mean of {next(iter(means.values())).tasks} tasks"] if means else []
    points = [_points(each, names, values, means) for each in shown]
    intervals = [run_interval(found) for found in values.values() if len(found) >= FEWEST]
    note = (
        "Return minus that of an idle robot, as a share of a published policy's: 0 is an idle robot, 1 a published "
        "policy that never fails; an early fall is near 0 too. Hollow: training runs. "
        f"{interval_note(intervals, 'Bars')} None for fewer than {FEWEST} runs of a task. "
        f"{words.start_states({results.start_states(setting, each.method) for setting, each in values})}"
    )
    chart = point_chart([*head, *map(words.setting, names)], points, Axis("gain over an idle robot"), theme.WIDE)
    yield Figure(NAME, f"Gain over an idle robot in {results.grid.steps:,} steps", chart, note, wide=True)


def _points(
    condition: Condition,
    names: Sequence[str],
    values: Mapping[tuple[str, Condition], Mapping[int, float]],
    means: Mapping[Condition, MeanGain],
) -> Points:
    first = 1 if means else 0
    rows, found, rings = list[int](), list[tuple[float, float, float]](), list[list[float]]()
    if condition in means:
        gain = means[condition].gain
        rows, found, rings = [0], [(gain.estimate, gain.lower, gain.upper)], [[]]
    for row, name in enumerate(names, first):
        if runs := values.get((name, condition)):
            rows.append(row)
            few = len(runs) < FEWEST
            found.append((fmean(runs.values()), np.nan, np.nan) if few else bounds(run_interval(runs)))
            rings.append(list(runs.values()))
    x, lower, upper = (np.array(each) for each in zip(*found, strict=True))
    return Points(words.condition(condition), rows, x, styles.style(condition), lower, upper, rings)
