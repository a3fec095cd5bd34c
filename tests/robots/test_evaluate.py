"""From a contract and an exported policy to a verdict that speaks of the walk."""

import json
import math

import numpy as np
import polars as pl
import pytest

import perdure
from perdure.errors import PerdureError
from perdure.evaluate import reference
from perdure.report import estimate_table, read_table, wording
from perdure.report.schema import COLUMNS, MEASURES, table_episodes
from perdure.report.summary import Summary
from tests.robots.conftest import ANT

OPTIONS = {"steps": 200, "eval_seeds": 2, "disturb": "none", "training_horizon": 50, "cores": 1, "on": "here"}


@pytest.fixture(scope="module")
def result(policy_file, tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reference, "EPISODES", 2)
        patch.setattr(reference, "STEPS", 50)
        yield perdure.extrapolate(str(policy_file), str(ANT), out=tmp_path_factory.mktemp("out"), **OPTIONS)


def test_the_table_has_the_measures(result):
    frame, _ = read_table(result.path)
    assert frame.columns == [*COLUMNS, *MEASURES]
    assert frame.equals(result.frame.select(frame.columns))
    for name in MEASURES:
        values = result.final[name].to_numpy()
        assert np.isfinite(values).all()
        assert len(set(values)) == 2  # of two start states
    assert frame["step_seconds"].unique().to_list() == [pytest.approx(0.05)]


def test_the_verdict_and_the_summary_speak_of_the_walk(result, tmp_path):
    medians = {name: float(np.median(result.final[name])) for name in MEASURES}
    text = str(result)
    assert medians["heading_error"] > 10.0
    shown = {name: wording.quantity(value) for name, value in medians.items()}
    assert f"turns {shown['heading_error']} degrees a minute from its commanded heading" in text
    assert f"drifts {shown['lateral_drift']} m a minute" in text
    (group,) = json.loads(Summary.of(estimate_table(result.frame), tmp_path, tmp_path, {}).to_json())["groups"]
    assert group["measures"] == pytest.approx(medians)


def test_a_finished_evaluation_is_not_run_again(result, policy_file):
    seen = []
    again = perdure.extrapolate(str(policy_file), str(ANT), out=result.path.parent, observe=seen.append, **OPTIONS)
    assert not seen
    assert again.frame.equals(result.frame)


def test_a_straight_walk_is_called_nothing_else(result):
    straight = result.frame.with_columns(heading_error=pl.lit(4.0), energy_per_meter=pl.lit(math.nan))
    (estimate,) = next(iter(estimate_table(straight).values()))
    assert "turns 4.00 degrees a minute from its commanded heading; drifts" in estimate.verdict.evidence
    assert "J/m" not in estimate.verdict.evidence


def test_tables_without_measures_are_read_as_before(result):
    plain = result.frame.select(list(COLUMNS))
    (episodes,) = table_episodes(plain, "it")
    assert all(np.isnan(episodes.facts[name].to_numpy()).all() for name in MEASURES)
    assert "degrees a minute" not in str(perdure.evaluate.ExtrapolationResult(plain, None))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (pl.col("heading_error") * -1.0, "heading_error must be a number"),
        (pl.col("step") * 1.0, "more than one heading_error"),
        (pl.col("step").alias("heading_error"), "'heading_error' is Int64, not Float64"),
    ],
)
def test_measures_that_make_no_sense_are_refused(result, change, message):
    with pytest.raises(PerdureError, match=message):
        table_episodes(result.frame.with_columns(heading_error=change), "it")
