"""The small tables: training runs, rules for C without a sweep, the thesis' sentences; and those of the page."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from typing import Any

import numpy as np
import polars as pl

from perdure.report import wording
from perdure.stats import Difference, compare_paired, compare_unpaired, compare_with, mean_difference
from studies.horizon.claims import SCORE, Condition, decide, effect, read_claims
from studies.horizon.grid import CLEANRL, MAIN_SETTINGS, SWEPT, Row
from studies.horizon.results import TEST, VALIDATION, Results

PPO, CHOSEN = Condition("ppo"), Condition("geometric", "chosen")
SCORED = (
    PPO,
    Condition("ppo-undiscounted"),
    Condition("ppo-average-reward"),
    Condition("linear", "constant:500"),
    Condition("random-horizon"),
    CHOSEN,
)
"""Methods whose scores are averaged over tasks; `random-horizon` is the last one without its input."""
METHODS = {
    "ppo": "discounted PPO",
    "ppo-undiscounted": "undiscounted PPO",
    "geometric": "geometric time-to-go",
    "linear": "linear time-to-go",
    "ppo-average-reward": "average-reward PPO",
    "random-horizon": "random horizon, no time-to-go",
    "geometric-fixed": "geometric time-to-go, fixed horizon",
    "ppo-short": "PPO, episodes of 200 steps",
    "ppo-undiscounted-terminal": "undiscounted PPO, no bootstrap",
    "linear-10-workers": "linear time-to-go, ten workers",
    "linear-random": "linear time-to-go, random horizon",
    "geometric-5": "geometric time-to-go, five numbers",
    "geometric-10": "geometric time-to-go, ten numbers",
    "geometric-film": "geometric time-to-go, FiLM",
}
"""In words. The first eight are in the order of the theme's styles; others share the last one's."""
RULE_WORDS = {
    "chosen": "cross-validated C",
    "chosen periodic": "cross-validated C, repeated countdown",
    "best": "best C of the sweep",
    "value": "C by the critic",
    "bandit": "C by successive halving",
    "countdown": "countdown to the end",
}


COMPARED = (
    (CHOSEN, PPO),
    (CHOSEN, Condition("random-horizon")),
    (CHOSEN, Condition("linear-random", "constant:500")),
    (Condition("ppo-average-reward"), PPO),
    (Condition("linear", "constant:500"), PPO),
)
FAILURES = (PPO, Condition("ppo-average-reward"), CHOSEN)
CLOCKS = {
    **{f"constant:{c}": f"C = {c:,}" for c in (0, 100, 200, 300, 500, 1000)},
    "countdown": "countdown",
    "chosen periodic": "repeated countdown",
}


def all_tables(results: Results) -> dict[str, pl.DataFrame]:
    """Return the tables by the name of their file; those without a row are left out."""
    frames = {"runs": results.runs[TEST], "rules": rule_table(results), "claims": claim_table(results)}
    return {name: frame for name, frame in frames.items() if not frame.is_empty()}


def _mean(values: Collection[float]) -> float:
    return float(np.mean(list(values))) if len(values) else float("nan")


def claim_table(results: Results) -> pl.DataFrame:
    """Return the sentences of the thesis whose tasks are all evaluated, each with effect, interval and decision."""
    rows = []
    for claim in read_claims():
        if (found := effect(claim, results.values)) is not None:
            numbers = {"effect": found.estimate, "lower": found.lower, "upper": found.upper}
            tasks = {"tasks": ", ".join(claim.tasks), "right": str(claim.right)}
            decision = decide(claim, found.lower, found.upper)
            rows.append(vars(claim) | tasks | numbers | {"runs": found.count, "decision": decision})
    return pl.DataFrame(rows)


def rule_table(results: Results) -> pl.DataFrame:
    """Return what each rule for C costs and loses beside the cross-validated sweep, per setting and method."""
    rows = [found for row in results.grid.rows if row.method in SWEPT for found in _rules(results, row)]
    return pl.DataFrame(rows, infer_schema_length=None)


def _rules(results: Results, row: Row) -> Iterator[dict[str, Any]]:
    chosen = results.values(row.setting, Condition(row.method, "chosen"))
    mine = (pl.col("setting") == row.setting) & (pl.col("method") == row.method)
    swept = results.episodes.filter(mine & (pl.col("split") == VALIDATION) & (pl.col("clock_kind") == "constant"))
    if not chosen or swept.is_empty():
        return
    cost = {"chosen": float(swept["end_step"].sum()) / len(row.seeds)}
    for rule in ("chosen", "value", "bandit"):
        returns = results.values(row.setting, Condition(row.method, rule))
        used = results.rules.filter(mine & (pl.col("rule") == rule))
        if not returns:
            continue
        difference = compare_paired(returns, chosen)
        yield {
            "setting": row.setting,
            "method": row.method,
            "rule": rule,
            "runs": difference.count,
            "simulated steps for each run": cost.get(rule, float(used["simulated_steps"].mean() or 0.0)),  # type: ignore[arg-type]
            "return": difference.left,
            "beside cross-validation": difference.estimate,
            "lower": difference.lower,
            "upper": difference.upper,
        }


def main_settings(results: Results) -> tuple[str, ...]:
    """Return the settings whose scores are averaged: `grid.MAIN_SETTINGS`, as far as the grid has them."""
    return tuple(setting for setting in results.grid.settings if setting in MAIN_SETTINGS)


def scores(results: Results, setting: str, condition: Condition) -> dict[int, float]:
    """Return the score against a published policy of each training run, by seed; {} where one of them is not there."""
    found = results.values(setting, condition, SCORE)
    return found if all(map(math.isfinite, found.values())) else {}


def mean_score(results: Results, left: Condition, right: Condition | float = 0.0) -> Difference | None:
    """Return the mean over tasks of a method's score minus a number or another's; None where a task lacks one.

    Every task counts alike, whatever its number of training runs.
    """
    settings = main_settings(results)
    sides = [
        [list(scores(results, setting, each).values()) for setting in settings]
        for each in (left, right)
        if isinstance(each, Condition)
    ]
    if len(settings) < 2 or any(len(runs) < 2 for side in sides for runs in side):
        return None
    if isinstance(right, Condition):
        return mean_difference([compare_unpaired(*runs) for runs in zip(*sides, strict=True)])
    return mean_difference([compare_with(runs, right) for runs in sides[0]])


def page_tables(results: Results) -> dict[str, pl.DataFrame]:
    """Return the tables of the page by name; their cells are texts: a number, perhaps with its 95 % interval."""
    scores = [{"method": method_words(each.method), "score": _mean_cell(results, each, 0.0, ".2f")} for each in SCORED]
    effects = [
        {"left": method_words(a.method), "right": method_words(b.method), "left minus right": _mean_cell(results, a, b)}
        for a, b in COMPARED
    ]
    failures, clocks, ends = [], [], []
    for setting in main_settings(results):
        task = {"task": setting_words(setting)}
        failed = {each: list(results.values(setting, each, "failed share").values()) for each in FAILURES}
        failures.append(task | {method_words(each.method): _share_cell(runs) for each, runs in failed.items() if runs})
        returns = {clock: _mean(results.values(setting, Condition("geometric", clock)).values()) for clock in CLOCKS}
        clocks.append(
            task | {name: f"{returns[clock] / returns['constant:500']:.2f}" for clock, name in CLOCKS.items()}
        )
        reward = results.mechanism.filter(
            (pl.col("setting") == setting) & (pl.col("method") == "geometric") & (pl.col("measure") == "reward")
        )
        spans = {"1 to 50 steps to go": (50, 50), "301 to 700 steps to go": (350, 700)}
        means = {name: _mean(reward.filter(pl.col("at").is_between(*span))["result"]) for name, span in spans.items()}
        ends.append(task | {name: f"{mean:.2f}" for name, mean in means.items()})
    rows = {"scores": scores, "effects": effects, "failures": failures, "clocks": clocks, "ends": ends}
    tables = {name: pl.DataFrame(found) for name, found in rows.items()}
    claims = [
        {"the thesis": each["sentence"], "effect": _cell(each["effect"], each["lower"], each["upper"], "+.2f")}
        | {"our runs": each["decision"]}
        for each in claim_table(results).to_dicts()
    ]
    return tables | {"claims": pl.DataFrame(claims)}


def _mean_cell(results: Results, left: Condition, right: Condition | float, form: str = "+.2f") -> str:
    found = mean_score(results, left, right)
    return "not evaluated" if found is None else _cell(found.estimate, found.lower, found.upper, form)


def _share_cell(runs: list[float]) -> str:
    found = compare_with(runs, 0.0)
    return _cell(found.left, max(found.lower, 0.0), min(found.upper, 1.0), ".0%")


def _cell(estimate: float, lower: float, upper: float, form: str) -> str:
    return f"{estimate:{form}} [{lower:{form}}, {upper:{form}}]"


def method_words(name: str) -> str:
    """Return a method in words: "ppo-gamma-0.99" -> "PPO, discount 0.99"."""
    if name.startswith("ppo-gamma-"):
        return f"PPO, discount {name.removeprefix('ppo-gamma-')}"
    return METHODS.get(name, name)


def rule_words(name: str) -> str:
    """Return a rule for the clock in words."""
    kind, colon, steps = name.partition(":")
    return wording.clock(kind, steps) if colon else RULE_WORDS[name]


def condition_words(each: Condition) -> str:
    """Return a method and its clock in words."""
    return (
        method_words(each.method) if each.clock == "none" else f"{method_words(each.method)}, {rule_words(each.clock)}"
    )


def setting_words(name: str) -> str:
    """Return a setting in words: "Hopper-v3@cleanrl" -> "Hopper-v3 (CleanRL)"."""
    task, _, preset = name.partition("@")
    return f"{task} (CleanRL)" if preset == CLEANRL else task
