"""The small tables: training runs, rules for C without a sweep, the thesis' sentences; and those of the page."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from perdure.report import wording
from perdure.report.outcomes import NeverWorked
from perdure.stats import compare_paired
from studies.disturbance.claims import CLAIMS as REGISTERED
from studies.horizon.claims import Claim, Condition, decide, effect, holm, p_value, read_claims
from studies.horizon.grid import CLEANRL, MAIN_SETTINGS, METHODS, SWEPT, Row
from studies.horizon.results import TEST, VALIDATION, Results

PPO, CHOSEN = Condition("ppo"), Condition("geometric", "chosen")
RULE_WORDS = {"chosen": "cross-validated C", "best": "best C of the sweep"}
AGAINST_PPO = 1
AGAINST_LONG = 6
"""Claims of `REGISTERED`, counted from 1, whose sides are the columns of the first table: under action noise, the
method against discounted PPO and against PPO with a discount of 0.999."""
FRESH_MEASURES = {"working share": "works (share)", "work": "work"}
DISTURBED = Path(__file__).parents[2] / "results" / "disturbance" / "tables"
REGISTERED_TASKS = ("Hopper-v3@cleanrl", "Walker2d-v3@cleanrl", "HalfCheetah-v3")
REGISTERED_NAMES = tuple(setting.partition("@")[0] for setting in REGISTERED_TASKS)
REGISTERED_COLUMNS = ("left minus right", "by task", "by work", "speeds", "power")
CLOCKS = {
    **{f"constant:{c}": f"C = {c:,}" for c in (0, 100, 200, 300, 500, 1000)},
    "countdown": "countdown",
    "chosen periodic": "repeated countdown",
}


def all_tables(results: Results) -> dict[str, pl.DataFrame]:
    """Return the tables by the name of their file; those without a row are left out."""
    frames = {
        "runs": results.runs.filter(split=TEST).drop("split"),
        "rules": rule_table(results),
        "claims": claim_table(results),
    }
    return {name: frame for name, frame in frames.items() if not frame.is_empty()}


def _mean(values: Collection[float]) -> float:
    return float(np.mean(list(values))) if len(values) else float("nan")


def claim_table(results: Results) -> pl.DataFrame:
    """Return the sentences of the thesis whose tasks are all evaluated, each with effect, interval and decision."""
    rows = []
    for claim in read_claims():
        if (found := effect(claim, results.values)) is not None:
            numbers = {"effect": found.estimate, "lower": found.lower, "upper": found.upper}
            numbers |= {"p": p_value(claim, found), "p, Holm": math.nan}
            tasks = {"tasks": ", ".join(claim.tasks), "right": str(claim.right)}
            decision = decide(claim, found.lower, found.upper)
            without = {"hangs on": ", ".join(_deciding_tasks(claim, results, decision))}
            rows.append(vars(claim) | tasks | numbers | {"runs": found.count, "decision": decision} | without)
    for row, corrected in zip(rows, holm([row["p"] for row in rows]), strict=True):
        row["p, Holm"] = corrected
    return pl.DataFrame(rows)


def _deciding_tasks(claim: Claim, results: Results, decision: str) -> Iterator[str]:
    """Yield the tasks without which the decision over several tasks would be another one."""
    if len(claim.tasks) < 2:
        return
    for task in claim.tasks:
        others = tuple(each for each in claim.tasks if each != task)
        found = effect(replace(claim, tasks=others), results.values)
        if found is not None and decide(claim, found.lower, found.upper) != decision:
            yield setting_words(task)


def rule_table(results: Results) -> pl.DataFrame:
    """Return what each rule for C costs and loses beside the cross-validated sweep, per setting and method."""
    rows = [found for row in results.grid.rows if row.method in SWEPT for found in _rules(results, row)]
    return pl.DataFrame(rows, infer_schema_length=None)


def _rules(results: Results, row: Row) -> Iterator[dict[str, Any]]:
    chosen = results.values(row.setting, Condition(row.method, "chosen"))
    mine = {"setting": row.setting, "method": row.method}
    swept = results.episodes.filter(split=VALIDATION, clock_kind="constant", **mine)
    if not chosen or swept.is_empty():
        return
    cost = {"chosen": float(swept["end_step"].sum()) / len(row.seeds)}
    for rule in ("chosen", "bandit"):
        returns = results.values(row.setting, Condition(row.method, rule))
        used = results.rules.filter(rule=rule, **mine)
        if not returns:
            continue
        difference = compare_paired(returns, chosen)
        yield {
            **mine,
            "rule": rule,
            "runs": difference.count,
            "simulated steps for each run": cost.get(rule, float(used["simulated_steps"].mean() or 0.0)),  # type: ignore[arg-type]
            "return": difference.left,
            "beside cross-validation": difference.estimate,
            "lower": difference.lower,
            "upper": difference.upper,
        }


def page_tables(results: Results) -> dict[str, pl.DataFrame]:
    """Return the tables of the page by name; their cells are texts: a number, perhaps with its 95 % interval."""
    rows = {
        "fresh": _fresh_rows(),
        "registered": _registered_rows(),
        "clocks": _clock_rows(results),
        "claims": _claim_rows(results),
    }
    return {name: pl.DataFrame(list(found)) for name, found in rows.items()}


def _clock_rows(results: Results) -> Iterator[dict[str, str]]:
    """Yield the returns under each clock, and rewards by steps to go, of the geometric method on each main task."""
    for setting in (each for each in results.grid.settings if each in MAIN_SETTINGS):
        returns = {clock: _mean(results.values(setting, Condition("geometric", clock)).values()) for clock in CLOCKS}
        row = {name: f"{returns[clock] / returns['constant:500']:.2f}" for clock, name in CLOCKS.items()}
        reward = results.mechanism.filter(setting=setting, measure="reward")
        for name, span in {"reward, last 50 (PPO)": (50, 50), "301 to 700 (PPO)": (350, 700)}.items():
            there = reward.filter(pl.col("at").is_between(*span))
            ours, plain = (_mean(there.filter(method=method)["result"]) for method in ("geometric", "ppo"))
            row[name] = f"{ours:.2f} ({plain:.2f})"
        states = set(results.episodes.filter(setting=setting, method="geometric")["policy_state"])
        yield {"task": setting_words(setting) + ", never worked" * (states == {NeverWorked.name})} | row


def _claim_rows(results: Results) -> Iterator[dict[str, str]]:
    for each in claim_table(results).iter_rows(named=True):
        effect = _numbers(each["effect"], each["lower"], each["upper"], "+.2f")
        decision = each["decision"]
        if each["hangs on"]:
            decision += f"; not without {each['hangs on']}"
        yield {"the thesis": each["sentence"], "effect": effect, "our runs": decision}


def _fresh_rows() -> Iterator[dict[str, str]]:
    """Yield how long ten fresh training runs of three methods work under noise, and how much they do."""
    table = pl.read_csv(DISTURBED / "work.csv")
    for setting, measure in product(REGISTERED_TASKS, FRESH_MEASURES):
        task = setting.partition("@")[0]
        here = table.filter(task=task, measure=measure)
        for plain in here.filter(claim=AGAINST_PPO).to_dicts():
            longer = here.filter(claim=AGAINST_LONG).row(0, named=True)
            yield {
                "task": task,
                "measure": FRESH_MEASURES[measure],
                METHODS["ppo"]: f"{plain['right mean']:.2f}",
                METHODS["ppo-gamma-0.999"]: f"{longer['right mean']:.2f}",
                METHODS["geometric"]: f"{plain['left mean']:.2f}",
                "method minus PPO": _numbers(plain["effect"], plain["low"], plain["high"], "+.2f"),
            }


def _registered_rows() -> Iterator[dict[str, str]]:
    """Yield the registered claims, each over the tasks that have runs of both sides."""
    claims = pl.read_csv(DISTURBED / "claims.csv")
    work = pl.read_csv(DISTURBED / "work.csv").filter(measure="work")
    for number, claim in enumerate(REGISTERED, 1):
        left, right = (METHODS[side].replace(" time-to-go", "") for side in (claim.left, claim.right))
        words = f"{f'{number}. ' if claim.registered else ''}{left} against {right}, {claim.condition}"
        if claim.margin:
            words += f", at most {claim.margin:g} less"
        if claim.measure == "gain in training":
            words += ", speed in training"
        row = dict.fromkeys(REGISTERED_COLUMNS, "") | {"decision": "runs are missing"}
        by_task = claims.filter(pl.col("task").is_in(REGISTERED_NAMES), claim=number)
        effects = dict(by_task.select("task", "effect").iter_rows())
        row["by task"] = ", ".join(f"{effects[task]:+.2f}" for task in REGISTERED_NAMES if task in effects)
        for each in claims.filter(claim=number).tail(1).to_dicts():
            row["decision"] = each["decision"] or row["decision"]
            row["left minus right"] = _numbers(each["effect"], each["low"], each["high"], "+.2f")
            row["speeds"] = f"{each['left speed']:.2f}, {each['right speed']:.2f}"
            row["power"] = f"{each['power']:.2f}" if each["power"] else ""
        for each in work.filter(claim=number).tail(1).to_dicts():
            row["by work"] = _numbers(each["effect"], each["low"], each["high"], "+.2f")
        yield {"claim": words} | row


def _numbers(estimate: float, lower: float, upper: float, form: str = ".2f") -> str:
    return f"{estimate:{form}}" + (f" [{lower:{form}}, {upper:{form}}]" if lower < upper else "")


def condition_words(each: Condition) -> str:
    """Return a method and its clock in words."""
    if each.clock == "none":
        return METHODS[each.method]
    kind, _, steps = each.clock.partition(":")
    return f"{METHODS[each.method]}, {RULE_WORDS.get(kind) or wording.clock(kind, steps)}"


def setting_words(name: str) -> str:
    """Return a setting in words: "Hopper-v3@cleanrl" -> "Hopper-v3 (CleanRL)"."""
    task, _, preset = name.partition("@")
    return f"{task} (CleanRL)" if preset == CLEANRL else task
