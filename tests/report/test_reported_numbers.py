"""Numbers of summaries, figures and JSON against tables whose truth is known."""

import json
import math
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from perdure.report import estimate_table, summary_text
from perdure.report.figures import make_figures
from perdure.report.summary import Summary
from tests.report.conftest import build

HOUR = {"disturbance": "standard-1", "step_seconds": 3.6, "rate": 2.0}
FALLS = [2400] * 5 + [math.inf] * 2


def estimates(*episodes, **more):
    return estimate_table(build(list(episodes), **more))


def disturbed(ends):
    return estimate_table(build([HOUR | {"ends": ends}], len(ends), recorded=(100, 1000, 2000, 4000)))


def group(found):
    return json.loads(Summary.of(found, Path("t"), Path("p"), {}).to_json())["groups"][0]


def cell(frame, column):
    head, row = summary_text(frame).splitlines()[-2:]
    return row[head.index(column) :].split()[0]


def test_clocks_are_compared_within_a_training_run():
    slow, fast = ({"clock": f"constant({c})", "rate": rate} for c, rate in ((1, 1.0), (2, 1.5)))
    runs = [build([{**each, "rate": each["rate"] + seed} for each in (slow, fast)], 3, (seed,)) for seed in (0, 1)]
    one, two = (each.group for each in estimate_table(pl.concat(runs))["Hopper-v3"])
    mine, its = two.paired(one)
    np.testing.assert_allclose(two.returns[mine, -1] - one.returns[its, -1], 50_000.0)


def test_an_idle_robot_is_subtracted_in_the_summary_and_in_the_plane():
    assert cell(build([{"rate": 2.0, "idle_rate": 1.0}]), "training vs published") == "0.333"
    (_, others) = make_figures(estimates({"rate": 2.0, "idle_rate": 0.5}, train_seeds=(0, 1))["Hopper-v3"])
    (plane,) = (each for each in others if each.name.endswith("plane"))
    assert {row["y"] for rows in plane.spec["datasets"].values() for row in rows if "y" in row} == {1.5}


def test_start_states_that_behave_as_one_have_no_interval():
    (item,) = estimates({"rate": 2.0})["Hopper-v3"]
    assert np.isnan([item.verdict.share.lower, item.verdict.share.upper]).all()


def test_failures_per_hour_and_their_bounds():
    found = group(disturbed(FALLS))
    assert list(found["failures_per_hour"].values()) == pytest.approx([0.25, 0.0985, 0.5257], abs=1e-4)
    assert found["median_failure_step"] == 2400


def test_bounds_of_the_mean_return_surround_it():
    mean = group(estimates({"rate": 2.0, "spread": 0.3}))["mean_return"]
    assert mean["low"] < mean["estimate"] < mean["high"]


def test_a_policy_that_never_worked_has_no_score():
    never = {"policy_state": "never worked", "end_score_vs_training": math.nan}
    (item,) = estimates({"rate": 1.0, "ends": [2000] * 8, **never})["Hopper-v3"]
    assert np.isnan(item.group.final_score).all()


def test_running_is_the_share_at_the_end():
    assert cell(build([{"rate": 2.0, "ends": [500] * 4 + [math.inf] * 4}]), "running") == "50"
