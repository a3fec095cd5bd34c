"""Caveats: when a policy that holds is not clean."""

import json
import math
from pathlib import Path

import polars as pl
import pytest

from perdure.report import estimate_table
from perdure.report.caveats import Caveat
from perdure.report.summary import Summary, not_clean, not_holding


def clean(synthetic, count=8, **changes):
    """A policy that holds when calm and in `count` disturbed episodes, which have these columns."""
    calm = synthetic([{"rate": 2.0, "spread": 0.1, "low_share": 0.0}], episodes=3)
    rows = {"rate": 2.0, "spread": 0.1, "disturbance": "push:1", "work_vs_calm": 0.9, "low_share": 0.0} | changes
    return pl.concat([calm, synthetic([rows], episodes=count)], how="diagonal")


def reasons(table):
    """Names of the caveats of the disturbed episodes."""
    (estimates,) = estimate_table(table).values()
    return list(estimates[-1].verdict.caveats)


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({}, None),
        ({"work_vs_calm": 0.76}, None),
        ({"work_vs_calm": 0.74}, "works less than when calm"),
        ({"low_share": 0.05}, None),
        ({"low_share": 0.06}, "is interrupted"),
        ({"count": 6}, None),
        ({"count": 5}, "met few disturbances"),
        ({"idle_rate": 2.0, "training_rate": 2.0, "spread": 0.0}, "earns no more than an idle robot"),
        ({"idle_rate": 2.0, "training_rate": 2.0, "spread": 0.0, "idle_steps": 499.0}, None),
        (
            {"idle_rate": 2.0, "training_rate": 2.0, "spread": 0.0, "idle_steps": 501.0},
            "earns no more than an idle robot",
        ),
        ({"other_engine": "trained in MuJoCo 2.1.0, judged in MuJoCo 3.6.0"}, "was trained in another simulator"),
    ],
)
def test_each_rule_on_both_sides_of_its_bound(synthetic, changes, name):
    assert reasons(clean(synthetic, **changes)) == ([] if name is None else [name])


@pytest.mark.parametrize(
    ("measure", "value", "crooked"),
    [("heading_error", 9.0, False), ("heading_error", 11.0, True), ("lateral_drift", 6.0, True)],
)
def test_a_robot_that_turns_or_drifts(synthetic, measure, value, crooked):
    table = clean(synthetic).with_columns(pl.lit(value).alias(measure))
    assert reasons(table) == ["does not walk straight"] * crooked


def test_green_only_where_the_interval_of_work_supports_it(synthetic):
    """Work of 0.85 on average; Student's interval of 0.6 and 1.1 in turns reaches from 0.63."""
    table = clean(synthetic)
    uneven = pl.when(pl.col("eval_seed") % 2 == 0).then(0.6).otherwise(1.1)
    disturbed = pl.col("disturbance") != "none"
    table = table.with_columns(work_vs_calm=pl.when(disturbed).then(uneven).otherwise("work_vs_calm"))
    assert reasons(table) == ["works less than when calm"]


def test_what_a_requirement_names(synthetic):
    estimates = estimate_table(clean(synthetic, low_share=0.5))
    assert not_holding(estimates) == []
    (missed,) = not_clean(estimates)
    assert "is interrupted" in missed


def test_a_policy_that_fails_has_no_caveats(synthetic):
    assert reasons(clean(synthetic, count=2, ends=[500, 600])) == []


def test_the_json_document_says_what_each_run_is_judged_by(synthetic):
    table = clean(synthetic).with_columns(way_rate=pl.lit(1.8), training_rate=2.0)
    document = json.loads(Summary.of(estimate_table(table), Path("t"), Path("p"), {}).to_json())
    assert document["clean"] is True
    (run,) = document["groups"][1]["training_runs"]
    assert run["score_that_holds"] == pytest.approx(0.9 + 0.25 * 0.1)
    assert (run["training_rate"], run["idle_steps"]) == (2.0, None)


def test_a_caveat_of_another_package_is_found(synthetic):
    class Squeaks(Caveat):
        name = "squeaks"
        order = 9

        def reason(self, held):
            return "it squeaks"

    try:
        assert reasons(clean(synthetic)) == ["squeaks"]
    finally:
        Squeaks.name = "is clean"
        Squeaks.reason = lambda self, held: ""


def test_nothing_is_known_of_an_older_table(synthetic):
    """Its added columns are nan; only the number of disturbed episodes counts."""
    assert reasons(clean(synthetic, work_vs_calm=math.nan, low_share=math.nan)) == []
