"""What an evaluation writes down, on worlds whose every reward and fall is known."""

from __future__ import annotations

import dataclasses

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scripted import SCRIPTED, Script, evaluate, policy_for

from perdure.extrapolate import LaneSpec
from perdure.extrapolate.checkpoints import LINEAR, checkpoint_steps
from perdure.extrapolate.evaluate import END_REASONS
from perdure.extrapolate.table import lane_table
from perdure.report import read_table, write_table

STEPS = 40
SCRIPTS = [
    Script(),
    Script(falls_at=7),
    Script(cut_at=20),
    Script(falls_at=20, cut_at=20),
    Script(falls_at=STEPS),
    Script(reward=lambda step: float(step)),
    Script(falls_at=1),
    Script(reward=lambda step: -2.0, falls_at=38),
]


@pytest.fixture(scope="module")
def records():
    return evaluate(SCRIPTS, STEPS)


class TestCheckpoints:
    @given(steps=st.integers(1, 2_000_000))
    def test_rise_from_the_first_step_to_the_last_and_stay_few(self, steps):
        found = checkpoint_steps(steps)
        assert (found[0], found[-1]) == (1, steps)
        assert np.all(np.diff(found) > 0)
        assert len(found) <= LINEAR + 65

    def test_cover_both_axes_of_a_long_evaluation(self):
        found = set(checkpoint_steps(100_000).tolist())
        assert {1, 10, 100, 1_000, 10_000, 100_000} <= found, "whole decades of the log axis"
        assert set(range(1_000, 100_001, 1_000)) <= found, "hundredths of the linear axis"

    def test_every_step_of_a_short_evaluation_is_one(self):
        assert checkpoint_steps(30).tolist() == list(range(1, 31))


class TestEnds:
    def test_reasons_are_told_apart_and_a_fall_at_a_cut_is_a_fall(self, records):
        assert [END_REASONS[reason] for reason in records.end_reason] == [
            "survived",
            "terminated",
            "truncated",
            "terminated",
            "terminated",
            "survived",
            "terminated",
            "terminated",
        ]

    def test_a_lane_lasts_as_many_steps_as_it_made(self, records):
        assert records.end_step.tolist() == [40, 7, 20, 20, 40, 40, 1, 38]

    def test_returns_count_every_reward_up_to_the_last_and_stay_there(self, records):
        at = {int(step): i for i, step in enumerate(records.steps)}
        assert records.returns[0].tolist() == list(range(1, 41))
        assert records.returns[1, [at[6], at[7], at[8], at[40]]].tolist() == [6, 7, 7, 7]
        assert records.returns[5, at[40]] == 820
        assert records.returns[7, [at[37], at[40]]].tolist() == [-74, -76]

    def test_the_first_tenth_is_a_mean_over_all_its_steps_lived_or_not(self, records):
        np.testing.assert_allclose(records.first_tenth, [1, 1, 1, 1, 1, 2.5, 0.25, -2])

    def test_the_last_tenth_is_a_mean_over_all_its_steps_and_zero_for_the_dead(self, records):
        # Steps 37 to 40; the last lane lives through two of them.
        np.testing.assert_allclose(records.last_tenth, [1, 0, 0, 0, 1, 38.5, 0, -1])

    def test_lanes_that_all_end_early_keep_their_values_at_the_checkpoints_never_reached(self):
        early = evaluate([Script(falls_at=3), Script(falls_at=5)], 1000)
        assert early.returns[:, -1].tolist() == [3, 5]
        assert early.end_step.tolist() == [3, 5]
        assert early.last_tenth.tolist() == [0, 0]
        np.testing.assert_allclose(early.first_tenth, [0.03, 0.05])


def test_the_dead_change_nothing_for_the_living(records):
    alone = evaluate([SCRIPTS[0]], STEPS)
    np.testing.assert_array_equal(alone.returns[0], records.returns[0])
    np.testing.assert_array_equal(alone.last_observation[0], records.last_observation[0])


def test_memory_does_not_grow_with_the_steps():
    def size(steps):
        records = evaluate([Script(falls_at=3)] * 2, steps)
        return {f.name: getattr(records, f.name).shape for f in dataclasses.fields(records)}

    short, long = size(10_000), size(1_000_000)
    assert long["returns"][1] < 1.2 * short["returns"][1], "a hundred times the steps: two decades of checkpoints more"
    assert max(max(shape) for shape in long.values()) == long["returns"][1]


@pytest.fixture(scope="module")
def frame(records):
    lanes = [LaneSpec(0, None, seed) for seed in range(len(SCRIPTS))]
    return lane_table(["p"], [policy_for(SCRIPTED)], lanes, records, STEPS)


class TestTable:
    def test_has_one_row_for_each_lane_and_checkpoint(self, frame):
        assert frame.height == len(SCRIPTS) * STEPS
        assert frame.select("eval_seed", "step").is_unique().all()

    def test_a_lane_is_alive_at_the_steps_it_completed_without_ending(self, frame):
        alive = frame.filter("alive").group_by("eval_seed").agg(pl.col("step").max()).sort("eval_seed")
        assert alive["eval_seed"].to_list() == [0, 1, 2, 3, 4, 5, 7], "lane 6 fell with its first step"
        assert alive["step"].to_list() == [40, 6, 19, 19, 39, 40, 37]

    def test_is_accepted_by_the_report_and_comes_back_from_its_file(self, frame, tmp_path):
        path = write_table(tmp_path / "lanes.parquet", frame, {"command": "none"})
        found, metadata = read_table(path)
        assert metadata["command"] == "none"
        assert found.sort("eval_seed", "step").select(frame.columns).equals(frame.sort("eval_seed", "step"))
