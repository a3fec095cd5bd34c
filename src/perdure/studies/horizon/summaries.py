"""The small tables: conditions, the choice of C and its bias, rules without a sweep."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import polars as pl

from perdure.report.statistics import TRAINING_SEEDS, Bootstrap, Units, t_interval
from perdure.studies.comparison import compare_paired
from perdure.studies.horizon.choose_clock import choose
from perdure.studies.horizon.claim import Condition
from perdure.studies.horizon.grid import SWEPT, Row
from perdure.studies.horizon.results import VALIDATION, Results
from perdure.studies.horizon.tables import MEASURED

KINDS = ("constant", "periodic")
RULES = ("best", "chosen", "chosen periodic", "value", "bandit", "countdown")
IQM = Bootstrap("iqm")


def condition_table(results: Results) -> pl.DataFrame:
    """Return every method under every rule for its clock: mean, interval and middle mean of the return, other means."""
    rows = [found for row in results.grid.rows for found in _conditions(results, row)]
    return pl.DataFrame(rows, infer_schema_length=None)


def _conditions(results: Results, row: Row) -> Iterator[dict[str, Any]]:
    runs = results.of(row)
    if runs.is_empty():
        return
    literal = runs["clock"].unique(maintain_order=True).to_list()
    rules = [rule for rule in RULES if rule not in literal] if row.method in SWEPT else []
    for rule in (*rules, *literal):
        condition = Condition(row.method, rule)
        returns = results.values(row.setting, condition)
        if returns:
            yield {
                "setting": row.setting,
                "method": row.method,
                "clock": rule,
                "runs": len(returns),
                **_interval(returns, "return"),
                **{name: _mean(results.values(row.setting, condition, name)) for name in MEASURED if name != "return"},
            }


def _interval(values: dict[int, float], name: str) -> dict[str, float]:
    units = Units(np.array([values[seed] for seed in sorted(values)]), TRAINING_SEEDS)
    mean, middle = t_interval(units), t_interval(units, how=IQM)
    return {
        name: float(mean.estimate),
        "lower": float(mean.lower),
        "upper": float(mean.upper),
        "middle mean": float(middle.estimate),
        "middle lower": float(middle.lower),
        "middle upper": float(middle.upper),
    }


def _mean(values: dict[int, float]) -> float:
    return float(np.mean(list(values.values()))) if values else float("nan")


def choice_table(results: Results) -> pl.DataFrame:
    """Return the cross-validated and the optimistic choice of each swept row and kind, and their difference."""
    rows = [found for row in results.grid.rows if row.method in SWEPT for found in _choices(results, row)]
    return pl.DataFrame(rows, infer_schema_length=None)


def _choices(results: Results, row: Row) -> Iterator[dict[str, Any]]:
    validation, test = results.of(row, VALIDATION), results.of(row)
    for kind in KINDS if len(validation) and len(test) else ():
        if kind not in validation["clock_kind"] or kind not in test["clock_kind"]:
            continue
        chosen, best = choose(validation, test, kind)
        if not (chosen.returns and best.returns):  # the chosen clock is not evaluated on test start states yet
            continue
        difference = compare_paired(best.returns, chosen.returns)
        yield {
            "setting": row.setting,
            "method": row.method,
            "kind": kind,
            "runs": difference.n_left,
            "chosen": " ".join(sorted(set(chosen.clocks.values()), key=lambda each: int(each.partition(":")[2]))),
            "cross-validated": chosen.mean,
            "optimistic clock": next(iter(best.clocks.values())),
            "optimistic": best.mean,
            "bias": difference.estimate,
            "lower": difference.lower,
            "upper": difference.upper,
        }


def rule_table(results: Results) -> pl.DataFrame:
    """Return what each rule for C costs and loses beside the cross-validated sweep, per setting and method."""
    rows = [found for row in results.grid.rows if row.method in SWEPT for found in _rules(results, row)]
    return pl.DataFrame(rows, infer_schema_length=None)


def _rules(results: Results, row: Row) -> Iterator[dict[str, Any]]:
    chosen = results.values(row.setting, Condition(row.method, "chosen"))
    table = results.validation.get(row.key)
    if not chosen or table is None:
        return
    ends = table.lanes.filter(pl.col("clock_kind") == "constant")["end_step"]
    cost = {"chosen": float(ends.sum()) / len(row.seeds)}
    for rule in ("chosen", "value", "bandit"):
        returns = results.values(row.setting, Condition(row.method, rule))
        used = results.rules.filter(
            (pl.col("setting") == row.setting) & (pl.col("method") == row.method) & (pl.col("rule") == rule)
        )
        if not returns:
            continue
        difference = compare_paired(returns, chosen)
        yield {
            "setting": row.setting,
            "method": row.method,
            "rule": rule,
            "runs": difference.n_left,
            "lane steps for each run": cost.get(rule, float(used["lane_steps"].mean() or 0.0)),  # type: ignore[arg-type]
            "return": difference.left,
            "beside cross-validation": difference.estimate,
            "lower": difference.lower,
            "upper": difference.upper,
        }
