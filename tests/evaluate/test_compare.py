"""Comparisons whose answer is known: a robot that pays its speed, and falls at half time on some grounds if fast.

Speed 1 falls at step 150 of 300 on every other start state: work 1/2 or 1. Speed 0.8 never falls: work 0.8.
"""

import json
import math

import numpy as np
import polars as pl
import pytest
from probes import Reach, Walkway
from scripted import policy_for
from test_early import walk

import perdure
from perdure.errors import PerdureError
from perdure.evaluate.compare import compare, rank
from perdure.policy import find_policies, save_policy
from perdure.report.comparison import compare_policies
from perdure.report.comparison_page import document_text, ranking_document, summary_document
from perdure.report.schema import read_table

pytestmark = pytest.mark.usefixtures("short_idle")
WALK = {"env": Walkway, "steps": 300, "training_horizon": 100, "disturb": "none"}


@pytest.fixture(scope="module")
def slow_and_slower():
    return compare(walk(0.8), walk(0.4), **WALK)


def numbers(result, measure):
    return result.measures.filter(measure=measure).row(0, named=True)


def test_the_one_that_does_less_work_is_worse(slow_and_slower):
    row = numbers(slow_and_slower, "work")
    # The unit is what the better one earns when calm: 0.8 a step.
    assert (row["a_estimate"], row["b_estimate"]) == pytest.approx((1.0, 0.5))
    assert slow_and_slower.verdict == "worse"
    assert slow_and_slower.more == 0.0
    assert not slow_and_slower.not_worse
    assert row["difference_low"] < -0.5 < row["difference_high"] < 0.0


def test_it_takes_as_many_start_states_as_the_difference_needs(slow_and_slower):
    # 8, 12, 18 start states ... at a difference of 0.5 of 1.25 on every one, until the wealth is 40.
    bets = np.linspace(0.05, 0.99, 20)
    needed = next(n for n in range(1, 100) if ((1 + bets * 0.5 / 1.25) ** n).mean() >= 40)
    looks = [8, 12, 18, 27, 40]
    assert slow_and_slower.summary.counts[0] == next(n for n in looks if n >= needed)
    assert slow_and_slower.frame["eval_seed"].max() + 1 == slow_and_slower.summary.counts[0]


def test_sides_that_are_swapped_get_the_opposite_answer(slow_and_slower):
    swapped = compare(walk(0.4), walk(0.8), **WALK)
    assert swapped.verdict == "better"
    assert swapped.not_worse
    mine = numbers(swapped, "work")
    other = numbers(slow_and_slower, "work")
    assert mine["difference_low"] == pytest.approx(-other["difference_high"])


def test_both_meet_the_same_start_states():
    result = compare(walk(1.0), walk(1.0), **WALK, most=12)
    ends = result.frame.filter(pl.col("step") == pl.col("test_horizon"))
    by_policy = [part["end_step"].to_list() for part in ends.partition_by("policy", maintain_order=True)]
    assert len(set(by_policy[0])) == 2, "some fall and some do not"
    assert by_policy[0] == by_policy[1]
    assert numbers(result, "work")["difference_estimate"] == 0.0


def test_equal_policies_are_not_told_apart_and_no_number_would():
    result = compare(walk(0.8), walk(0.8), **WALK, most=12)
    assert result.verdict == "cannot tell"
    assert result.more == math.inf
    assert "cannot tell" in str(result)
    assert not compare(walk(0.8), walk(0.8), **WALK, most=12, require="better").met


def test_not_worse_is_shown_with_enough_start_states():
    options = {**WALK, "require": "not-worse", "margin": 0.2}
    result = compare(walk(0.8), walk(0.8), **options)
    assert result.met
    assert result.summary.counts[0] < 100
    few = compare(walk(0.8), walk(0.8), **options, most=8)
    assert not few.met, "8 start states do not show it"


def test_the_measure_decides():
    # Fast: half of the episodes do not hold; its work (1/2 or 1: 0.75 on average) is that of speed 0.75.
    result = compare(walk(1.0), walk(0.75), **WALK, by="holds")
    assert result.verdict == "better"
    holds = numbers(result, "share that holds")
    assert holds["b_estimate"] == 1.0
    sides = (("policy 1", 0), ("policy 2", 0))
    assert compare_policies(result.frame, *sides, "work").verdict == "cannot tell"
    time = numbers(result, "time before a failure")
    assert time["b_estimate"] == 1.0
    assert time["a_estimate"] == pytest.approx((1.0 + holds["a_estimate"]) / 2.0, abs=0.02)


def test_under_a_disturbance_calm_episodes_are_shown_and_disturbed_ones_decide():
    options = {**WALK, "disturb": "action_noise:0.01", "most": 18}
    result = compare(walk(0.4), walk(0.8), **options)
    assert result.summary.condition == "action_noise:0.01"
    assert result.verdict == "better"
    assert result.measures["condition"].unique().sort().to_list() == ["action_noise:0.01", "none"]
    assert result.measures.filter(condition="none")["interval"].unique().to_list() != ["betting"]


def test_work_is_refused_where_the_task_ends_at_its_goal():
    def reach(observations):
        return np.sign(observations["desired_goal"] - observations["achieved_goal"])

    def stay(observations):
        return np.zeros_like(observations["desired_goal"])

    options = {"env": Reach, "steps": 40, "training_horizon": 20, "disturb": "none"}
    with pytest.raises(PerdureError, match="--by holds"):
        compare(stay, reach, **options)
    assert compare(stay, reach, **options, by="holds").verdict == "better"


@pytest.mark.parametrize(
    ("wrong", "word"),
    [
        ({"by": "score"}, "measure"),
        ({"most": 0}, "most"),
        ({"disturb": "push:0.1,0.2"}, "one condition"),
        ({"clocks": ("constant:1", "constant:2")}, "one clock"),
        ({"margin": -1.0}, "margin"),
        ({"mots": 3}, "did you mean"),
    ],
)
def test_wrong_options_are_named(wrong, word):
    with pytest.raises(PerdureError, match=word):
        compare(walk(0.8), walk(0.4), **{**WALK, **wrong})


class TestMethods:
    def test_the_training_run_is_the_unit(self):
        slow = [walk(speed) for speed in (0.38, 0.4, 0.41, 0.42)]
        fast = [walk(speed) for speed in (0.78, 0.8, 0.81, 0.84)]
        result = compare(slow, fast, **WALK, eval_seeds=2)
        assert result.verdict == "better"
        assert result.summary.unit == "training run"
        assert result.summary.counts == (4, 4)
        # Two of the 70 ways to divide eight runs are as far apart: the best possible p value is 0.029.
        assert "0.029" in str(result)

    def test_three_runs_a_side_cannot_decide_and_it_says_how_many_would(self):
        slow = [walk(speed) for speed in (0.38, 0.4, 0.41)]
        fast = [walk(speed) for speed in (0.78, 0.8, 0.81)]
        result = compare(slow, fast, **WALK, eval_seeds=2)
        assert result.verdict == "cannot tell"
        assert result.more == 1.0
        assert "1 more training run a side" in str(result)

    def test_runs_that_overlap_are_not_told_apart(self):
        slow = [walk(speed) for speed in (0.2, 0.4, 0.6, 0.8)]
        fast = [walk(speed) for speed in (0.3, 0.5, 0.7, 0.9)]
        result = compare(slow, fast, **WALK, eval_seeds=2)
        assert result.verdict == "cannot tell"
        # By the power calculation: (1.96 + 0.84)^2 x 2 variances / 0.1^2 runs a side.
        variance = np.var([0.2, 0.4, 0.6, 0.8], ddof=1)
        assert result.more == pytest.approx((1.96 + 0.8416) ** 2 * 2 * variance / 0.1**2 - 4, abs=1)

    def test_one_policy_is_not_compared_with_a_method(self):
        with pytest.raises(PerdureError, match="1 and B 2 policies"):
            compare(walk(0.8), [walk(0.4), walk(0.5)], **WALK)


class TestRanking:
    def test_the_winner_meets_the_second_on_fresh_start_states(self):
        result = rank([walk(0.4), walk(0.8), walk(0.3)], **WALK, eval_seeds=12)
        places = [each.name for each in result.ranking.policies]
        assert places == ["policy 2", "policy 1", "policy 3"]
        assert result.ranking.confirmed.verdict == "better"
        assert result.frame["eval_seed"].max() == 12 + 18 - 1
        fresh = result.frame.filter(pl.col("eval_seed") >= 12)
        assert fresh["policy"].unique().sort().to_list() == ["policy 1", "policy 2"]
        document = json.loads(document_text(ranking_document(result.ranking)))
        assert document["policies"][0]["value"]["estimate"] == pytest.approx(1.0)

    def test_fresh_start_states_are_fresh_for_calm_episodes_too(self):
        options = {**WALK, "disturb": "action_noise:0.01", "eval_seeds": 2, "most": 3}
        found = rank([walk(0.4), walk(0.8)], **options).frame.select("policy", "disturbance", "eval_seed").unique()
        seeds = found.filter(pl.col("disturbance") != "none").group_by("eval_seed").len().sort("eval_seed")
        assert seeds["eval_seed"].to_list() == [0, 1, 8, 9, 10]
        assert found.filter(disturbance="none")["eval_seed"].max() == 15

    def test_one_policy_is_no_ranking(self):
        with pytest.raises(PerdureError, match="one policy"):
            rank([walk(0.4)], **WALK)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two methods with two training runs each, as `perdure train` writes them."""
    folder = tmp_path_factory.mktemp("runs")
    task = perdure.load_policy("Hopper-v3/ppo").task
    for method, seed in (("ppo", 2), ("ppo", 10), ("geometric", 2)):
        policy = policy_for(task, seed=seed, method=method)
        (folder / method / f"seed-{seed}").mkdir(parents=True)
        save_policy(policy, folder / method / f"seed-{seed}" / "policy.safetensors")
    return folder


class TestFiles:
    def test_a_folder_of_training_runs_is_several_policies(self, folder):
        found = find_policies(folder / "ppo")
        assert [path.parent.name for path in found] == ["seed-2", "seed-10"]
        assert len(find_policies("Hopper-v3/ppo")) == 1

    def test_finished_episodes_are_used_again(self, folder, tmp_path):
        options = {"steps": 40, "most": 8, "disturb": "none", "by": "hours", "on": "here", "out": tmp_path}
        sides = (folder / "ppo" / "seed-2", folder / "geometric")
        evaluated = perdure.extrapolate(
            [str(each / "policy.safetensors") for each in (sides[0], sides[1] / "seed-2")],
            **{"steps": 40, "eval_seeds": 6, "disturb": "none", "on": "here", "out": tmp_path},
        )
        groups = sorted(path.name for path in (tmp_path / "groups").iterdir())
        first = compare(*sides, **options)
        added = [path for path in (tmp_path / "groups").iterdir() if path.name not in groups]
        ran = [row for path in added for row in json.loads((path / "unit.json").read_text())["config"]["episodes"]]
        assert len(ran) == 4, "two more start states for each of two policies"
        written, _ = read_table(first.path)
        assert written["eval_seed"].n_unique() == 8
        assert evaluated.path.is_file(), "the table of the evaluation stays"
        assert (tmp_path / "comparison.html").is_file()
        before = first.path.read_bytes()
        assert compare(*sides, **options).path.read_bytes() == before

    def test_the_document_has_every_number(self, slow_and_slower):
        document = json.loads(document_text(summary_document(slow_and_slower.summary)))
        assert document["verdict"] == "worse"
        work = next(row for row in document["measures"] if row["measure"] == "work")
        assert work["difference"]["estimate"] == pytest.approx(-0.5)
