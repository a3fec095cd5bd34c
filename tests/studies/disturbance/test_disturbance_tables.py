"""The study's tables against hand-made episodes: shares, the permutation test, and the foresight of the verdict."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from perdure.runs import Store
from studies.disturbance.claims import measure_runs
from studies.disturbance.cure import cure_table
from studies.disturbance.grid import CONDITIONS, subjects
from studies.disturbance.study import ROWS, collect, plan
from studies.disturbance.tables import all_tables, auc, fresh_shares
from studies.horizon.grid import METHODS

RESULTS = Path(__file__).parents[3] / "results" / "disturbance"

STEPS = 10_000


def episodes(method: str, condition: str, lives: dict[int, list[int]]) -> list[dict[str, object]]:
    """Return rows of episodes: the steps that each one of a training run lasted."""
    return [
        {
            "task": "Hopper-v3",
            "method": method,
            "condition": condition,
            "train_seed": run,
            "eval_seed": start,
            "test_horizon": STEPS,
            "end_reason": "survived" if life == STEPS else "terminated",
            "end_step": life,
            "outcome": "holds" if life == STEPS else "falls",
            "failed_step": life,
            "end_score_vs_training": 1.0,
            "policy_state": "worked",
        }
        for run, found in lives.items()
        for start, life in enumerate(found)
    ]


def test_left_counts_episodes() -> None:
    fragile = {run: [500, 600] for run in range(5)}
    sturdy = {run: [STEPS, STEPS] for run in range(4)} | {4: [STEPS, 1000]}
    rows = episodes("ppo@cleanrl", "calm", fragile) + episodes("geometric@cleanrl", "calm", sturdy)
    left = {row["method"]: row for row in all_tables(pl.DataFrame(rows))["left"].iter_rows(named=True)}
    ppo, geometric = left["discounted PPO"], left["geometric time-to-go"]
    assert (ppo["left"], ppo["episodes"], ppo["median life"]) == (0, 10, 500.0)
    assert (geometric["left"], geometric["left share"]) == (9, pytest.approx(0.9))
    assert geometric["working share"] == pytest.approx(0.91)


def test_runs_that_agree_have_no_interval() -> None:
    rows = episodes("ppo@cleanrl", "calm", {run: [STEPS, STEPS] for run in range(3)})
    (row,) = all_tables(pl.DataFrame(rows))["left"].iter_rows(named=True)
    assert (row["left share"], row["left low"], row["left high"], row["working low"]) == (1.0, None, None, None)
    committed = pl.read_csv(RESULTS / "tables" / "left.csv")
    assert committed.filter(
        (pl.col("left low") == pl.col("left high")) | (pl.col("working low") == pl.col("working high"))
    ).is_empty()


def test_a_policy_that_never_worked_has_no_working_share() -> None:
    rows = episodes("ppo", "calm", {0: [STEPS], 1: [STEPS]})
    frame = pl.DataFrame(rows).with_columns(policy_state=pl.lit("never worked"))
    assert all_tables(frame)["left"]["working share"].to_list() == [0.0]


@pytest.mark.parametrize(
    ("score", "held", "expected"),
    [([0.1, 0.9], [False, True], 1.0), ([0.9, 0.1], [False, True], 0.0), ([0.5, 0.5], [False, True], 0.5)],
)
def test_auc_of_two_runs(score: list[float], held: list[bool], expected: float) -> None:
    assert auc(np.array(score), np.array(held)) == expected


def test_auc_within_a_group_compares_its_own_runs_only() -> None:
    score, held, group = np.array([0.1, 0.2, 0.8, 0.9]), np.array([False, True, False, True]), np.array([0, 0, 1, 1])
    assert auc(score, held) == 0.75
    assert auc(score, held, group) == 1.0


def test_foresight_is_blind_where_every_run_holds_when_calm() -> None:
    runs = range(6)
    rows = episodes("ppo", "calm", {run: [STEPS] for run in runs})
    rows += episodes("ppo", "standard-1", {run: [STEPS if run < 3 else 400] for run in runs})
    rows += episodes("ppo", "slope of 3 degrees", {run: [STEPS if run < 3 else 900] for run in runs})
    table = all_tables(pl.DataFrame(rows))["foresight"].filter(threshold=0.75)
    assert dict(table.select("verdict", "AUC").iter_rows()) == {"calm": 0.5, "standard-1": 1.0, "both": 1.0}
    assert table["runs that fail"].to_list() == [3, 3, 3]
    first = (pl.col("condition") == "slope of 3 degrees") & (pl.col("train_seed") == 0)
    score = pl.when(first).then(math.nan).otherwise("end_score_vs_training")
    unjudged = pl.DataFrame(rows).with_columns(end_score_vs_training=score)
    assert set(all_tables(unjudged)["foresight"]["runs that fail"]) == {4}, "what cannot be judged does not hold"


def test_every_subject_is_planned_once_under_every_condition():
    keys = [unit.key for unit in plan("thesis", (1,), Path("runs"))]
    everywhere = sum(not condition.world for condition in CONDITIONS)
    walkers = sum(subject.task == "Walker2d-v3" for subject in subjects())
    assert len(keys) == len(set(keys)) == everywhere * len(list(subjects())) + walkers


def test_rows_of_a_finished_unit_replace_those_of_its_cell(tmp_path) -> None:
    unit = plan("thesis", (1,), tmp_path)[0]
    condition, task, method = unit.key.split("/")
    cell = {"task": task, "method": method, "condition": condition}
    rows = pl.DataFrame([{"train_seed": 0, "eval_seed": start, "return": 2.0} for start in (1, 0)])
    with Store(tmp_path / "runs").workspace(unit.key, unit.config) as work:
        rows.write_parquet(work.folder / ROWS)
    frozen = tmp_path / "episodes.parquet"
    old = cell | {"train_seed": 0, "eval_seed": 0, "return": 1.0}
    pl.DataFrame([old, old | {"condition": "z"}]).write_parquet(frozen)
    collect(Store(tmp_path / "runs"), 1, frozen)
    kept = pl.read_parquet(frozen).select("condition", "eval_seed", "return").rows()
    assert kept == [(condition, 0, 2.0), (condition, 1, 2.0), ("z", 0, 1.0)]


def test_cure_compares_steps_between_failures_with_those_of_ppo() -> None:
    fragile = {run: [500, 600] for run in range(5)}
    sturdy = {run: [STEPS, STEPS] for run in range(4)} | {4: [STEPS, 1000]}
    rows = [
        row | {"training_rate": rate, "idle_rate": 1.0, "published_rate": 5.0}
        for method, lives, rate in (("ppo@cleanrl", fragile, 5.0), ("geometric@cleanrl", sturdy, 4.6))
        for row in episodes(method, "standard-1", lives)
    ]
    found = {row["method"]: row for row in cure_table(pl.DataFrame(rows), "0 to 4").iter_rows(named=True)}
    ppo, geometric = found["discounted PPO"], found["geometric time-to-go"]
    assert (ppo["failures"], ppo["steps between failures"]) == (10, pytest.approx(5500 / 11))
    assert (geometric["failures"], geometric["steps between failures"]) == (1, pytest.approx(91_000 / 2))
    assert geometric["ratio to PPO"] == pytest.approx(91.0)
    assert geometric["low"] > 3.0
    assert geometric["speed against PPO"] == pytest.approx(0.9)
    assert (ppo["reaches the goal"], geometric["reaches the goal"]) == ("no", "yes")
    standing = pl.DataFrame([row | {"policy_state": "never worked"} for row in rows if row["method"] != "ppo@cleanrl"])
    table = cure_table(pl.concat([pl.DataFrame(rows).filter(method="ppo@cleanrl"), standing]), "0 to 4")
    assert table["failures"].to_list() == [10, 10], "a robot that stands fails from the start"


def test_the_numbers_that_the_page_has_of_the_cure_are_in_its_table():
    rows = pl.read_csv(RESULTS / "tables" / "cure.csv")

    def found(seeds, task, method):
        (row,) = rows.filter(seeds=seeds, task=f"{task}-v3", preset="cleanrl", method=method).to_dicts()
        return row

    cured = found("10 to 19", "Hopper", "average-reward PPO, trained under noise")
    walking = found("10 to 19", "Walker2d", "average-reward PPO")
    alone = found("0 to 9", "Hopper", "average-reward PPO"), found("20 to 22", "Hopper", "ppo+action_noise-0.1")
    page = " ".join((RESULTS / "README.md").read_text(encoding="utf-8").split())
    assert (cured["reaches the goal"], walking["reaches the goal"]) == ("yes", "no")
    fresh = pl.read_parquet(RESULTS / "registered.parquet").filter(task="Hopper-v3")
    failing = (
        fresh.group_by("method", "condition", "train_seed")
        .agg(count=(pl.col("outcome") != "holds").sum())
        .group_by("method", "condition")
        .agg(hold=(pl.col("count") == 0).sum(), fail=(pl.col("count") == 5).sum())
    )

    def counted(method, condition):
        return failing.filter(method=method, condition=condition).select("hold", "fail").row(0)

    noisy = "ppo-average-reward+action_noise-0.1@cleanrl"
    (held, failed), (pushed, _) = counted(noisy, "standard-1"), counted(noisy, "pushes of 0.5 m/s")
    assert f"{held} of 10 runs of average-reward PPO trained under action noise hold" in page
    assert (
        f"under `standard-1` and {failed} fail in every episode; under pushes of 0.5 m/s {pushed} of 10 holds" in page
    )
    assert counted("ppo@cleanrl", "standard-1") == counted("ppo@cleanrl", "pushes of 0.5 m/s") == (0, 10)
    assert f"{cured['speed against PPO']:.2f}" in page
    assert f"{walking['ratio to PPO']:.1f} [{walking['low']:.1f}, {walking['high']:.1f}]" in page
    assert all(f"{each['ratio to PPO']:.1f} times" in page for each in alone)
    assert [each["runs"] for each in alone] == [3, 1]  # as the page says


def test_of_the_runs_that_hold_when_calm_so_many_hold_when_disturbed():
    rows = pl.read_parquet(RESULTS / "episodes.parquet").filter(
        pl.col("method").str.contains("@") != (pl.col("task") == "HalfCheetah-v3"),
        pl.col("task").is_in(["Hopper-v3", "Walker2d-v3", "HalfCheetah-v3"]),
    )
    runs = rows.group_by("task", "method", "train_seed", "condition").agg(
        holds=((pl.col("outcome") == "holds") & (pl.col("policy_state") == "worked")).mean() >= 0.9
    )
    wide = runs.pivot(on="condition", index=["task", "method", "train_seed"], values="holds").filter("calm")
    noise, pushes, mild = wide.select("action noise 0.1", "pushes", "standard-1").sum().row(0)
    assert wide["method"].str.split("@").list.first().n_unique() == 9
    said = (
        f"Of {len(wide)} training runs of nine methods on Hopper, Walker2d and HalfCheetah that hold when calm, "
        f"{noise} hold under 10 % action noise, {pushes} under pushes"
    )
    assert f"{said} and {mild} under" in " ".join((RESULTS / "README.md").read_text().split())


def test_the_figure_of_fresh_runs_has_the_means_of_the_claims() -> None:
    shares = fresh_shares(measure_runs(pl.read_parquet(RESULTS / "registered.parquet")))
    claims = pl.read_csv(RESULTS / "tables" / "claims.csv").filter(
        pl.col("claim") <= 2, ~pl.col("task").str.contains(",")
    )
    for row in claims.iter_rows(named=True):
        for side in ("left", "right"):
            drawn = shares.filter(task=row["task"], condition=row["condition"], method=METHODS[row[side]])
            assert drawn["working share"].to_list() == [pytest.approx(row[f"{side} mean"])]
            assert 0.0 <= drawn["working low"][0] <= drawn["working share"][0] <= drawn["working high"][0] <= 1.0
    assert len(claims) == 6


def test_so_many_runs_that_hold_calm_and_disturbed_fail_under_each_new_condition():
    """As the page says, which leaves Swimmer out."""
    rows = pl.read_parquet(RESULTS / "episodes.parquet").filter(~pl.col("task").str.contains("Swimmer"))
    held = (pl.col("outcome") == "holds") & (pl.col("policy_state") == "worked")
    runs = rows.group_by("task", "method", "train_seed", "condition").agg(holds=held.mean())
    wide = runs.pivot(on="condition", index=["task", "method", "train_seed"], values="holds")
    good = wide.filter(pl.col("calm") >= 0.9, pl.col("standard-1") >= 0.9)
    named = ("mass x 1.2", "payload off center", "pushes", "slope of 3 degrees", "action noise 0.1", "slow actuators")
    page = " ".join((RESULTS / "README.md").read_text().split())
    cheetah = good.filter(task="HalfCheetah-v3")
    assert f"Of {len(good)} runs that hold calm and under `standard-1` ({len(cheetah)} of HalfCheetah" in page
    fails, its = (dict(zip(named, (each[name] <= 0.5 for name in named), strict=True)) for each in (good, cheetah))
    cells = [f"{fails[name].sum()}" + f" (HalfCheetah: {its[name].sum()})" * (name in named[-2:]) for name in named]
    assert f"| {' | '.join(cells)} |" in page
    foresight = pl.read_csv(RESULTS / "tables" / "foresight.csv").filter(threshold=0.75)
    within = foresight.pivot(on="verdict", index="new condition", values="AUC within a task")
    gap = (within["calm"] - within["standard-1"]).to_numpy()
    assert (gap > 0).sum() == 8
    assert f"by up to {gap.max():.2f} AUC" in page
    assert (within["both"] > within["calm"]).sum() == 8
