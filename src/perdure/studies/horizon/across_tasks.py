"""The gain over an idle robot by method, averaged over tasks."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import polars as pl

from perdure.studies.comparison import Difference, compare_unpaired, compare_with, mean_difference
from perdure.studies.horizon.claim import Condition
from perdure.studies.horizon.claims import MAIN_SETTINGS, PPO
from perdure.studies.horizon.results import Results

GAIN = "gain"
WITHOUT_INPUT = Condition("random-horizon")
"""The method without its input, and otherwise the same."""
METHODS = (
    Condition("ppo"),
    Condition("ppo-undiscounted"),
    Condition("ppo-average-reward"),
    Condition("linear", "constant:500"),
)
"""Compared with each other, with the control and with the method under its constant C."""


@dataclass(frozen=True)
class MeanGain:
    """The mean over tasks of a method's gain. Every task counts alike, whatever its number of training runs."""

    condition: Condition
    tasks: int
    runs: str
    """Of each task, such as "3" or "5 to 10"."""
    gain: Difference
    """The gain itself: its right side is 0."""
    beside_ppo: Difference | None
    """Minus that of discounted PPO; None for PPO."""


def conditions(results: Results) -> tuple[Condition, ...]:
    """Return what is compared, in the order of figures and tables."""
    return (*METHODS, WITHOUT_INPUT, results.constant)


def settings(results: Results) -> tuple[str, ...]:
    """Return the settings that are averaged: `claims.MAIN_SETTINGS`, as far as the grid has them."""
    return tuple(setting for setting in results.grid.settings if setting in MAIN_SETTINGS)


def gains(results: Results, setting: str, condition: Condition) -> dict[int, float]:
    """Return the gain of each training run, by seed; {} where it is not evaluated or no published policy is known."""
    found = results.values(setting, condition, GAIN)
    return found if all(map(math.isfinite, found.values())) else {}


def mean_gains(results: Results) -> list[MeanGain]:
    """Return the mean of every method that is evaluated on all of the tasks; none where there is one task only."""
    names = settings(results)
    return [found for each in conditions(results) if len(names) > 1 and (found := _mean_gain(results, each, names))]


def _mean_gain(results: Results, condition: Condition, names: tuple[str, ...]) -> MeanGain | None:
    by_task, beside = _by_task(results, condition, names), mean_gain_difference(results, condition, PPO)
    if not by_task or beside is None:
        return None
    gain = mean_difference([compare_with(runs, 0.0) for runs in by_task])
    counts = sorted({len(runs) for runs in by_task})
    runs = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    return MeanGain(condition, len(names), runs, gain, None if condition == PPO else beside)


def mean_gain_difference(results: Results, left: Condition, right: Condition) -> Difference | None:
    """Return the mean over tasks of the difference of two methods' gains; None where one is not evaluated on all."""
    names = settings(results)
    sides = [_by_task(results, each, names) for each in (left, right)]
    if len(names) < 2 or not all(sides):
        return None
    return mean_difference([compare_unpaired(*runs) for runs in zip(*sides, strict=True)])


def _by_task(results: Results, condition: Condition, names: tuple[str, ...]) -> list[list[float]]:
    """Return the gains of the training runs of each task; [] where one has too few."""
    by_task = [list(gains(results, setting, condition).values()) for setting in names]
    return by_task if all(len(runs) > 1 for runs in by_task) else []


def gain_table(results: Results) -> pl.DataFrame:
    """Return one row for each method, for tables/gain.csv."""
    return pl.DataFrame(list(_rows(results)), infer_schema_length=None)


def _rows(results: Results) -> Iterator[dict[str, object]]:
    for each in mean_gains(results):
        beside = each.beside_ppo
        yield {
            "method": each.condition.method,
            "clock": each.condition.clock,
            "tasks": each.tasks,
            "gain": each.gain.estimate,
            "lower": each.gain.lower,
            "upper": each.gain.upper,
            "beside ppo": beside.estimate if beside else None,
            "beside lower": beside.lower if beside else None,
            "beside upper": beside.upper if beside else None,
            "probability of improvement": beside.improvement if beside else None,
        }
