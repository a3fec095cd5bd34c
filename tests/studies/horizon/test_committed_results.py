"""The committed tables, figures and page are what the analysis makes of the frozen tables."""

import math
import re
from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from perdure.policy import load_policy
from perdure.report.charts import render
from studies.disturbance.claims import measure_runs
from studies.files import include_tables, read_parquet_file, write_csv
from studies.horizon.claims import effect, read_claims
from studies.horizon.figures import all_figures
from studies.horizon.grid import GRIDS
from studies.horizon.results import read_results
from studies.horizon.tables import all_tables, page_tables

RESULTS = Path(__file__).parents[3] / "results" / "horizon"
HOPPER_IDLE = 0.966
"""Reward per step of a Hopper that stands."""
NUMBER = re.compile(r"[-\u2212]?\d[\d,]*\.?\d*(?:e-?\d+)?")


@pytest.fixture(scope="module")
def results():
    return read_results(GRIDS["thesis"], RESULTS)


def test_tables_are_made_again(results, tmp_path):
    made = all_tables(results)
    assert set(made) == {path.stem for path in RESULTS.glob("tables/*.csv")}
    for name, frame in made.items():
        again = pl.read_csv(write_csv(tmp_path / f"{name}.csv", frame))
        assert_frame_equal(again, pl.read_csv(RESULTS / "tables" / f"{name}.csv"), rel_tol=1e-9, abs_tol=0.0)


def shown(svg):
    """What a figure shows, as its marks say it for screen readers: words and numbers, wherever they are drawn."""
    labels = "\n".join(re.findall(r'aria-label="([^"]*)"', svg))
    numbers = [float(each.replace(",", "").replace("\u2212", "-")) for each in NUMBER.findall(labels)]
    return NUMBER.sub("#", labels), numbers


@pytest.mark.parametrize("every", [10, pytest.param(1, marks=pytest.mark.verify)])
def test_figures_show_the_same_again(results, every):
    figures = list(all_figures(results))
    assert {f"{figure.name}.svg" for figure in figures} == {path.name for path in (RESULTS / "figures").iterdir()}
    for figure in figures[::every]:
        words, numbers = shown(render(figure, "svg").decode())
        committed_words, committed_numbers = shown((RESULTS / "figures" / f"{figure.name}.svg").read_text())
        assert words == committed_words, figure.name
        assert numbers
        assert all(map(math.isclose, numbers, committed_numbers)), figure.name


def test_the_tables_of_the_page_are_up_to_date(results, tmp_path):
    page = tmp_path / "README.md"
    page.write_bytes((RESULTS / "README.md").read_bytes())
    include_tables(page, page_tables(results))
    assert page.read_text() == (RESULTS / "README.md").read_text()


def test_the_page_says_that_the_method_never_walked_on_ant_and_humanoid(results):
    def reference(setting, method):
        found = results.episodes.filter(setting=setting, method=method, split="test")
        runs = found.group_by("train_seed").agg(pl.col("policy_state", "training_rate", "idle_rate").first())
        return len(runs), set(runs["policy_state"]), runs["training_rate"].mean(), runs["idle_rate"].mean()

    count, states, rate, idle = reference("Ant-v3", "geometric")
    plain_count, plain_states, plain_rate, _ = reference("Ant-v3", "ppo")
    assert (count, states, plain_count, plain_states) == (5, {"never worked"}, 5, {"worked"})
    page = " ".join((RESULTS / "README.md").read_text().split())
    assert f"({rate:.2f} reward per step within training; an idle robot {idle:.2f})" in page
    assert f"discounted PPO all worked ({plain_rate:.2f})" in page
    assert "holds" not in set(results.episodes.filter(setting="Ant-v3")["outcome"])
    assert reference("Humanoid-v3", "geometric")[:2] == (1, {"never worked"})
    clocks = page_tables(results)["clocks"]["task"]
    assert clocks.filter(clocks.str.contains("never worked")).to_list() == ["Ant-v3, never worked"]


def test_every_decided_sentence_survives_a_correction_for_their_number(results):
    """By the definition: the smallest p times 15, the next times 14, ..., and never below the one before."""
    table = all_tables(results)["claims"]
    assert len(table) == 15
    corrected, most = {}, 0.0
    for place, (sentence, p) in enumerate(sorted(table.select("sentence", "p").iter_rows(), key=lambda row: row[1])):
        most = max(most, (15 - place) * p)
        corrected[sentence] = min(most, 1.0)
    assert dict(table.select("sentence", "p, Holm").iter_rows()) == pytest.approx(corrected)
    decided = table.filter(pl.col("decision") != "undecided")["p, Holm"]
    page = " ".join((RESULTS / "README.md").read_text().split())
    assert decided.max() < 0.05
    assert f"All {len(decided)} decided rows survive Holm's correction over the 15 rows" in page
    assert f"{decided.max():.4f})" in page


def test_the_answer_says_what_the_tables_say_on_three_pages(results):
    page = " ".join((RESULTS / "README.md").read_text().split())
    answer = re.findall(r"\*\*Answer\.\*\* (.*?) !\[", page)[0]
    registered = page_tables(results)["registered"]
    assert registered["decision"].to_list() == ["supported"] * 5 + ["unregistered"]
    claims = pl.read_csv(RESULTS.parent / "disturbance" / "tables" / "claims.csv")
    decided = claims.filter(pl.col("decision") != "")
    method, plain_ppo, same_method, discounted, _, longer = (
        f"{100 * share:.0f} %" for row in (0, 2, 5) for share in decided.select("left mean", "right mean").row(row)
    )
    calm, simple = registered["left minus right"].gather([4, 5])
    difference = registered["left minus right"][0].replace("+", "")
    simple = simple.replace("+", "")
    assert f"When calm no gain is shown ({calm})" in answer
    assert f"works for {method} of 10,000 steps, discounted PPO for {plain_ppo} (difference {difference}; " in answer
    assert f"and the method with PPO's discount for {discounted}" in page
    longer_words = f"PPO with a discount of 0.999 works for {longer} (difference {simple}, unregistered)"
    assert longer_words in page
    for other in ("README.md", "docs/explanation/does-a-time-to-go-help.md"):
        told = " ".join((RESULTS.parents[1] / other).read_text().split())
        assert longer_words in told
        assert f"work for {method} of 10,000 steps, those of discounted PPO for {plain_ppo}" in told
        assert other != "README.md" or f"(difference {difference}; registered before the runs; " in told
    assert same_method == method


def test_the_answer_says_how_many_cured_episodes_hold():
    page = " ".join((RESULTS / "README.md").read_text().split())
    arms = pl.read_csv(RESULTS.parent / "cure" / "tables" / "arms.csv").filter(condition="standard-1")
    held = {
        (task, arm): episodes - failures
        for task, arm, episodes, failures in arms.select("task", "arm", "episodes", "failures").iter_rows()
    }
    cured, before = (
        [held[task, arm] for task in ("Hopper-v3", "Walker2d-v3")] for arm in ("continued-long-noise", "ppo")
    )
    assert f"hold in {cured[0]} of 35 episodes under small disturbances (before: {before[0]})" in page
    assert f"and seven Walker2ds in {cured[1]} (before: {before[1]})" in page


def test_the_page_says_how_the_method_compares_with_a_longer_discount(results):
    page = " ".join((RESULTS / "README.md").read_text().split())
    registered = page_tables(results)["registered"]
    speeds = registered["speeds"].head(2).str.split(", ").list.eval(pl.element().cast(pl.Float64)).to_list()
    assert {round(left / right, 1) for left, right in speeds} == {0.7}
    assert "While it works, the method earns 0.7 of what PPO earns" in page
    runs = measure_runs(pl.read_parquet(RESULTS.parent / "disturbance" / "registered.parquet"))
    shares = {
        (task, side): runs.filter(task=task, method=side, condition="action noise 0.1")["working share"]
        for task in ("Walker2d-v3", "HalfCheetah-v3")
        for side in ("ppo-gamma-0.999", "geometric")
    }
    walker, cheetah = (
        [f"{100 * shares[task, side].mean():.0f} %" for side in ("ppo-gamma-0.999", "geometric")]
        for task in ("Walker2d-v3", "HalfCheetah-v3")
    )
    assert "more on Walker2d ({}; the method {}), less on HalfCheetah ({}; {})".format(*walker, *cheetah) in page
    last = read_parquet_file(RESULTS / "learning.parquet").filter(
        pl.col("setting") == "Hopper-v3@cleanrl", pl.col("train_seed") >= 10, pl.col("step") > 900_000
    )
    rates = last.group_by("method", "train_seed").agg(
        rate=pl.col("return").sum() / pl.col("length").sum() - HOPPER_IDLE
    )
    gains = {method: part["rate"] for (method,), part in rates.group_by("method")}
    assert (gains["ppo-gamma-0.999"] < 0.25 * gains["ppo"].mean()).sum() > 5
    assert "on Hopper most runs with a discount of 0.999 hardly walk" in page
    episodes = results.episodes["split"].value_counts()
    assert sorted(episodes["count"]) == [2350, 14160]


def test_the_page_says_how_the_standing_threshold_matters():
    page = " ".join((RESULTS / "README.md").read_text().split())
    table = pl.read_csv(RESULTS.parent / "disturbance" / "tables" / "thresholds.csv")
    noise = table.filter(condition="action noise 0.1")
    plain = noise.filter(right="ppo").sort("threshold")
    assert plain.filter(pl.col("low") > 0)["threshold"].max() == 0.6
    longer = noise.filter(right="ppo-gamma-0.999")
    low, high = (longer.filter(threshold=each).row(0, named=True) for each in (0.0, 0.5))
    words = "{effect:+.2f} [{low:+.2f}, {high:+.2f}]"
    assert f"from {words.format(**low)} (threshold 0) to {words.format(**high)} (0.5)" in page


def test_so_many_runs_of_discounted_ppo_hold_and_fall_when_calm(results):
    fresh = pl.read_parquet(RESULTS.parent / "disturbance" / "registered.parquet")
    fresh = fresh.filter(task="Hopper-v3", method="ppo@cleanrl", condition="calm")
    earlier = results.episodes.filter(setting="Hopper-v3@cleanrl", method="ppo", split="test")
    runs = pl.concat([each.select("train_seed", "outcome") for each in (earlier, fresh)]).group_by("train_seed")
    every = runs.agg(holds=(pl.col("outcome") == "holds").all(), falls=(pl.col("outcome") == "falls").all())
    assert (len(every), every["holds"].sum(), every["falls"].sum()) == (20, 7, 11)
    page = " ".join((RESULTS.parents[1] / "docs" / "how-to" / "when-a-policy-fails.md").read_text().split())
    assert "seven of twenty runs of discounted PPO on Hopper held" in page
    assert "for 100,000 calm steps, and eleven fell from each" in page


def test_on_ant_alone_short_episodes_decide_nothing(results):
    claim = next(each for each in read_claims() if each.left == "ppo-short" and "Ant-v3" in each.tasks)
    lower = {task: effect(replace(claim, tasks=(task,)), results.values) for task in claim.tasks}
    assert [task for task, found in lower.items() if found.upper < 0.0] == ["Hopper-v3@cleanrl", "Walker2d-v3@cleanrl"]


def test_committed_policies_hold_actors_alone_and_can_be_deployed():
    paths = sorted((RESULTS / "policies").rglob("*.safetensors"))
    for path in paths[::40]:
        policy = load_policy(path)
        assert not policy.has_critic
        assert policy.reference is not None
        assert policy.provenance["seed"] == int(path.stem.removeprefix("seed-"))
