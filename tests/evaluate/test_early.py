"""An evaluation that must hold ends when it cannot, with the verdict that it would have had."""

import json

import numpy as np
import polars as pl
import pytest
from probes import Walkway

import perdure
from perdure.cli.extrapolate import write_and_show
from perdure.evaluate.early import parts
from perdure.evaluate.options import Condition

pytestmark = pytest.mark.usefixtures("short_idle")
CALM = Condition("none", (), 100_000, 3)
DISTURBED = Condition("standard-1", (), 10_000, 36)


def walk(speed):
    def policy(observations):
        return np.full((len(observations), 1), speed)

    return policy


def evaluate(speed, **options):
    asked = {"steps": 300, "eval_seeds": 36, "disturb": "none", "training_horizon": 100}
    return perdure.extrapolate(walk(speed), Walkway, **asked, **options)


def test_some_start_states_of_the_cheapest_condition_come_first():
    seeds = [[(each.label, each.eval_seeds) for each in part] for part in parts([CALM, DISTURBED])]
    assert seeds == [[("standard-1", 8)], [("standard-1", 16)], [("standard-1", 32)], [("standard-1", 36)]]
    assert list(parts([CALM])) == []


def test_it_stops_when_four_of_36_episodes_have_failed():
    result = evaluate(1.0, stop_early=True)
    full = evaluate(1.0)
    ran = result.final.height
    assert ran in (8, 16)
    assert (result.final["outcome"] == "falls").sum() >= 4
    assert (result.final["outcome"].head(ran // 2) == "falls").sum() < 4 or ran == 8
    assert (result.stopped.episodes, result.stopped.planned) == (ran, 36)
    assert f"{ran} of 36 episodes" in str(result)
    assert not result.holds
    assert not full.holds
    assert result.frame.equals(full.frame.filter(pl.col("eval_seed") < ran)), "what ran is the same"


def test_page_and_summary_say_that_it_stopped(tmp_path, capsys):
    evaluate(1.0, stop_early=True, out=tmp_path)
    assert "of 36 episodes" in (tmp_path / "report.html").read_text()
    with pytest.raises(SystemExit):
        write_and_show(tmp_path / "episodes.parquet", tmp_path, (), "holds", as_json=True)
    document = json.loads(capsys.readouterr().out)
    ran = sum(group["episodes"] for group in document["groups"])
    assert document["stopped_early"].pop("reason")
    assert document["stopped_early"] == {"episodes": ran, "planned": 36}


def test_where_everything_holds_nothing_is_left_out():
    result = evaluate(0.5, stop_early=True)
    assert result.stopped is None
    assert result.holds
    assert result.frame.equals(evaluate(0.5).frame)
