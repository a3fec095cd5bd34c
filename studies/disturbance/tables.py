"""Tables and figures of the study: who is left under which disturbance, and what the verdict foresees."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product

import numpy as np
import polars as pl

from perdure.report.charts import Axis, Figure, Points, point_chart, style
from perdure.report.estimates import HOLDING_SHARE
from perdure.report.outcomes import WORKED, Holds
from perdure.stats import FloatArray, compare_with, mean_interval, median_time
from studies.disturbance.claims import CALM, NOISE, PUSHES, measure_runs
from studies.disturbance.grid import CONDITIONS, TASKS
from studies.horizon.grid import METHODS

THRESHOLDS = (0.5, 0.65, 0.75, 0.85)
"""Least score against its own training at the end of an episode that holds; 0.75 is the verdict's."""
PREDICTORS = ("calm", "standard-1", "both")
"""Whose share of episodes that hold foresees; both: the mean of the two."""
RESAMPLES = 2000
DRAWN = ("ppo", "geometric", "ppo-average-reward", "ppo-undiscounted")
DRAWN_UNDER = (CALM, NOISE)
FRESH_DRAWN = ("ppo", "ppo-gamma-0.999", "geometric")
SHARE = "working share"
FRESH_MEASURES = {
    "noise": (NOISE, SHARE),
    "pushes": (PUSHES, SHARE),
    "calm": (CALM, "score"),
    "speed": (CALM, "gain in training"),
}
"""Of `method_table`: name to condition and measure."""
MAIN = (pl.col("preset") == "cleanrl") | pl.col("task").str.starts_with("HalfCheetah")
"""Of the settings of a task the one that is shown."""


def all_tables(episodes: pl.DataFrame) -> dict[str, pl.DataFrame]:
    """Return the tables of the study by name.

    Args:
        episodes: A row for each episode: the columns of `studies.disturbance.study.COLUMNS`, method and condition.
    """
    worked = pl.col("policy_state") == WORKED
    share = pl.col("failed_step") / pl.col("test_horizon")
    episodes = episodes.with_columns(
        method=pl.col("method").str.split("@").list.first(),
        preset=pl.col("method").str.split("@").list.get(1, null_on_oob=True).fill_null("zoo"),
        left=pl.col("end_reason") == "survived",
        works=pl.when(worked).then(share).otherwise(0.0),
        holds=worked & (pl.col("outcome") == Holds.name),
    )
    return {"left": left_table(episodes), "foresight": foresight_table(episodes)}


def left_table(episodes: pl.DataFrame) -> pl.DataFrame:
    """Return episodes left and working share of each task, method and condition, with 95 % intervals over runs."""
    rows = []
    order = {name: place for place, name in enumerate([*METHODS, *sorted(set(episodes["method"]) - set(METHODS))])}
    names = [condition.name for condition in CONDITIONS]
    groups = episodes.partition_by("task", "preset", "condition", "method", as_dict=True)
    for key, part in sorted(
        groups.items(), key=lambda each: (each[0][0], each[0][1], names.index(str(each[0][2])), order[str(each[0][3])])
    ):
        rng = np.random.default_rng(0)  # for each row anew: no interval depends on which others there are
        task, preset, condition, method = map(str, key)
        held = part.group_by("train_seed").agg(pl.col("holds").mean())
        values, runs = part.select(pl.col("left").cast(pl.Float64), "works"), part["train_seed"].to_numpy()
        share, working = (mean_interval(each.to_numpy(), runs, rng).within(0.0, 1.0) for each in values)
        rows.append(
            {
                "task": task,
                "preset": preset,
                "condition": condition,
                "method": METHODS.get(method, method),
                "steps": part["test_horizon"][0],
                "runs": part["train_seed"].n_unique(),
                "runs that hold": int((held["holds"] >= HOLDING_SHARE).sum()),
                "episodes": len(part),
                "left": int(part["left"].sum()),
                "left share": float(share.estimate),
                "left low": float(share.lower),
                "left high": float(share.upper),
                "median life": median_time(part["end_step"].to_numpy(), ~part["left"].to_numpy()),
                "working share": float(working.estimate),
                "working low": float(working.lower),
                "working high": float(working.upper),
            }
        )
    return pl.DataFrame(rows, infer_schema_length=None).fill_nan(None)


def foresight_table(episodes: pl.DataFrame) -> pl.DataFrame:
    """Return how well shares of episodes that hold, calm or under `standard-1`, foresee failures in new conditions.

    A training run fails in a condition if at most half of its episodes hold there. AUC: the chance that a run that
    holds had a greater share than a run that fails; ties count half. Intervals: bootstrap over training runs.
    AUC within a task compares runs of one task and preset only.
    """
    rows, rng = [], np.random.default_rng(0)
    new = [each for each in CONDITIONS if each.name not in PREDICTORS]
    for threshold in THRESHOLDS:
        enough = pl.col("end_score_vs_training").is_between(threshold, np.inf)  # nan >= threshold is true in Polars
        holds = pl.col("left") & (pl.col("policy_state") == WORKED) & enough
        shares = (
            episodes.group_by("task", "preset", "method", "train_seed", "condition")
            .agg(holds.mean().alias("share"))
            .pivot("condition", index=("task", "preset", "method", "train_seed"), values="share", sort_columns=True)
            .sort("task", "preset", "method", "train_seed")
        )
        if {"calm", "standard-1"} <= set(shares.columns):
            shares = shares.with_columns(both=(pl.col("calm") + pl.col("standard-1")) / 2)
        for condition in (each for each in new if each.name in shares.columns):
            for predictor in (each for each in PREDICTORS if each in shares.columns):
                known = shares.drop_nulls([condition.name, predictor])
                score, held = known[predictor].to_numpy(), known[condition.name].to_numpy() > 0.5
                low, high = _bootstrap(score, held, rng)
                rows.append(
                    {
                        "threshold": threshold,
                        "new condition": condition.name,
                        "in standard-1": "no" if condition.held_out else "weaker",
                        "verdict": predictor,
                        "runs": len(known),
                        "runs that fail": int((~held).sum()),
                        "AUC": auc(score, held),
                        "low": low,
                        "high": high,
                        "AUC within a task": auc(score, held, known["task", "preset"].hash_rows().to_numpy()),
                    }
                )
    return pl.DataFrame(rows)


def auc(score: FloatArray, held: np.ndarray, group: np.ndarray | None = None) -> float:
    """Return the area under the receiver operating characteristic: Mann and Whitney's U / (n m); nan for one class.

    With `group`, only runs of one group are compared.
    """
    above = score[held][:, None] - score[~held][None, :]
    if group is not None:
        above = above[group[held][:, None] == group[~held][None, :]]
    return float((np.sign(above) + 1.0).mean() / 2.0) if above.size else float("nan")


def _bootstrap(score: FloatArray, held: np.ndarray, rng: np.random.Generator) -> tuple[float, float]:
    drawn = rng.integers(len(score), size=(RESAMPLES, len(score)))
    found = np.array([auc(score[rows], held[rows]) for rows in drawn])
    found = found[np.isfinite(found)]
    return (float(np.quantile(found, 0.025)), float(np.quantile(found, 0.975))) if found.size else (np.nan, np.nan)


def draw_figures(tables: Mapping[str, pl.DataFrame], fresh: pl.DataFrame | None = None) -> Iterator[Figure]:
    """Draw how long policies work: earlier runs, calm and under noise, and fresh ones (episodes), disturbed."""
    note = "Bars: 95 % intervals over training runs ({}), five start states each. Failure: as the verdict has it."
    title, left = "How long policies work, ", tables["left"].filter(MAIN)
    yield _figure("working", title + "calm and under action noise", left, DRAWN, DRAWN_UNDER, note.format("3 to 10"))
    if fresh is not None:
        drawn = fresh_shares(measure_runs(fresh)), FRESH_DRAWN, (NOISE, PUSHES)
        yield _figure("fresh", title + "disturbed", *drawn, note.format("10") + " A run that stands: 0.")


def fresh_shares(runs: pl.DataFrame) -> pl.DataFrame:
    """Return the working share of each task, method and condition as `left_table` has it, from `measure_runs`."""
    rows = []
    for (task, condition, method), part in runs.group_by("task", "condition", "method"):
        found = compare_with(part["working share"], 0.0)
        low, high = np.clip((found.lower, found.upper), 0.0, 1.0)
        rows.append((task, condition, METHODS[str(method)], found.estimate, low, high))
    names = ("task", "condition", "method", "working share", "working low", "working high")
    return pl.DataFrame(rows, names, orient="row")


def method_table(runs: pl.DataFrame) -> pl.DataFrame:
    """Return the working shares, score and speed of each task and method with 95 % intervals, from `measure_runs`."""
    rows = []
    for (task, method), part in sorted(runs.group_by("task", "method")):
        row = {"task": task, "method": METHODS[str(method)], "runs": part["train_seed"].n_unique()}
        for name, (condition, measure) in FRESH_MEASURES.items():
            found = compare_with(part.filter(condition=condition)[measure], 0.0)
            bounds = (0.0, 1.0) if measure == SHARE else (-np.inf, np.inf)
            low, high = np.clip((found.lower, found.upper), *bounds)
            row |= {name: found.estimate, f"{name} low": low, f"{name} high": high}
        rows.append(row)
    return pl.DataFrame(rows, infer_schema_length=None)


def _figure(
    name: str, title: str, shares: pl.DataFrame, methods: Sequence[str], conditions: Sequence[str], note: str
) -> Figure:
    """Draw a row for each task and condition, a series for each method."""
    rows = pl.DataFrame(list(product(TASKS, conditions)), ("task", "condition"), orient="row")
    series = []
    for place, method in enumerate(methods):
        found = shares.filter(method=METHODS[method])
        mine = (
            rows.join(found, rows.columns, "left", maintain_order="left").with_row_index().drop_nulls("working share")
        )
        middle, low, high = (mine[f"working {each}"].to_numpy() for each in ("share", "low", "high"))
        points = Points(METHODS[method], mine["index"].to_list(), middle, style(place), low, high)
        series += [points] * bool(len(mine))
    labels = [f"{task.removesuffix('-v3')}, {each.removeprefix('action ')}" for task, each in rows.iter_rows()]
    chart = point_chart(labels, series, Axis("steps before failure, as a share of 10,000", low=0.0, high=1.0))
    return Figure(name, title, chart, note)


def page_tables(tables: Mapping[str, pl.DataFrame]) -> dict[str, pl.DataFrame]:
    """Return the tables that the page includes, as text."""
    shown = tables["left"].filter(
        pl.col("method").is_in([METHODS[name] for name in ("ppo", "geometric", "ppo-undiscounted")])
        & MAIN
        & (pl.col("steps") == 10_000)
    )
    fallen = (
        pl.when(pl.col("task") != "HalfCheetah-v3")
        .then(pl.format(" ({}/{})", "left", "episodes"))
        .otherwise(pl.lit(""))
    )
    main = shown.with_columns(cell=pl.format("{}/{}{}", "runs that hold", "runs", fallen))
    main = main.pivot("method", index=("task", "condition"), values="cell")
    foresight = tables["foresight"].filter(pl.col("threshold") == 0.75, pl.col("verdict") != "both")
    names = ("AUC", "low", "high")
    cells = foresight.with_columns(
        cell=pl.format("{} [{}, {}]", *(pl.col(name).round(2).cast(pl.String) for name in names))
    ).pivot("verdict", index=("new condition", "runs that fail"), values="cell")
    found = {"left": main, "foresight": cells}
    if "cure" in tables:
        rare = tables["cure"].filter(MAIN, pl.col("low") > 1, pl.col("speed against PPO") > 0.5, pl.col("runs") > 2)
        ratio = pl.format("{} [{}, {}]", *(pl.col(name).round(1) for name in ("ratio to PPO", "low", "high")))
        found["cure"] = rare.select(
            *("seeds", "task", "method", "runs", "failures", pl.col("steps between failures").cast(pl.Int64)),
            ratio.alias("ratio to PPO"),
            pl.col("speed against PPO").round(2),
        )
    return {name: frame.select(pl.all().cast(pl.String)) for name, frame in found.items()}
