"""The top of a page: one line, and commands that a reader can copy."""

import math

import polars as pl
import pytest

from perdure.report.estimates import estimate_table
from perdure.report.lead import confirming, one_line


def line(table):
    return one_line([item.verdict for item in estimate_table(table)["Hopper-v3"]])


def test_a_policy_that_falls_only_when_disturbed_is_said_to(synthetic):
    calm = {"clock": "none", "method": "ppo", "spread": 0.3}
    assert line(synthetic([calm, calm | {"disturbance": "push:0.5", "ends": [500] * 8}])) == "ppo falls when disturbed"
    some = synthetic([calm | {"ends": [500] * 3 + [math.inf] * 5}])
    assert line(some) == "ppo falls in 3 of 8 episodes"


def test_many_policies_and_clocks_are_counted(synthetic):
    groups = [{"clock": f"constant({c})", "ends": [500 if c < 2 else math.inf] * 8} for c in range(5)]
    calm = synthetic(groups)
    assert line(pl.concat([calm, calm.with_columns(disturbance=pl.lit("push:1"))])).startswith("3 of 5 policies")


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        ("perdure extrapolate a.zip --out 'my runs'", "a.zip --first-eval-seed 1000 --out 'my runs-confirmed'"),
        ("perdure extrapolate a --first-eval-seed=5", "a --first-eval-seed 1005 --out extrapolation-confirmed"),
    ],
)
def test_an_evaluation_is_repeated_from_other_start_states(command, expected):
    assert confirming(command) == f"perdure extrapolate {expected}"


@pytest.mark.parametrize(
    "command", ["", "rm -rf /", "perdure extrapolate 'a", "perdure extrapolate a --first-eval-seed x"]
)
def test_what_is_no_evaluation_is_not_repeated(command):
    assert confirming(command) == ""
