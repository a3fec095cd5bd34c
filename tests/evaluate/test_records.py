"""What an evaluation writes down, on worlds whose every reward and fall is known."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scripted import SCRIPTED, Script, evaluate, policy_for, world_of

from perdure.errors import PerdureError
from perdure.evaluate import EpisodeSpec, evaluate_episodes
from perdure.evaluate.episodes import MOST_RECORDED_WINDOWS, recorded_steps, window_steps
from perdure.evaluate.judge import judge_table
from perdure.evaluate.table import episode_table, with_not_applied
from perdure.evaluate.verdict import ScoreScale
from perdure.policy.reference import Reference
from perdure.report import read_table, write_table
from perdure.report.schema import END_REASONS

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


class TestRecordedSteps:
    @given(steps=st.integers(1, 2_000_000))
    def test_rise_from_the_first_step_to_the_last_and_stay_few(self, steps):
        found = recorded_steps(steps)
        assert (found[0], found[-1]) == (1, steps)
        assert np.all(np.diff(found) > 0)
        assert len(found) <= MOST_RECORDED_WINDOWS + 65
        assert set(window_steps(steps)) <= set(found)

    def test_cover_both_axes_of_a_long_evaluation(self):
        found = set(recorded_steps(100_000).tolist())
        assert {1, 10, 100, 1_000, 10_000, 100_000} <= found, "whole decades of the log axis"
        assert set(range(1_000, 100_001, 1_000)) <= found, "hundredths of the linear axis"

    def test_every_step_of_a_short_evaluation_is_one(self):
        assert recorded_steps(30).tolist() == list(range(1, 31))


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

    def test_a_episode_lasts_as_many_steps_as_it_made(self, records):
        assert records.end_step.tolist() == [40, 7, 20, 20, 40, 40, 1, 38]

    def test_returns_count_every_reward_up_to_the_last_and_stay_there(self, records):
        at = {int(step): i for i, step in enumerate(records.steps)}
        assert records.returns[0].tolist() == list(range(1, 41))
        assert records.returns[1, [at[6], at[7], at[8], at[40]]].tolist() == [6, 7, 7, 7]
        assert records.returns[5, at[40]] == 820
        assert records.returns[7, [at[37], at[40]]].tolist() == [-74, -76]

    def test_episodes_that_all_end_early_keep_their_values_at_the_recorded_steps_never_reached(self):
        early = evaluate([Script(falls_at=3), Script(falls_at=5)], 1000)
        assert early.returns[:, -1].tolist() == [3, 5]
        assert early.end_step.tolist() == [3, 5]


def test_the_dead_change_nothing_for_the_living(records):
    alone = evaluate([SCRIPTS[0]], STEPS)
    np.testing.assert_array_equal(alone.returns[0], records.returns[0])


def test_memory_does_not_grow_with_the_steps():
    def size(steps):
        records = evaluate([Script(falls_at=3)] * 2, steps)
        return {f.name: np.shape(getattr(records, f.name)) for f in dataclasses.fields(records)}

    short, long = size(1_000_000), size(100_000_000)
    assert long["returns"][1] < 1.05 * short["returns"][1], (
        "a hundred times the steps: two decades of recorded steps more"
    )
    assert max(max(shape, default=0) for shape in long.values()) == long["returns"][1]


class TestMovement:
    """One component of three moves, by 0.3 a step where it does; training standard deviations are 1."""

    def test_is_measured_early_and_late(self):
        stops = Script(place=lambda step: 0.3 * (min(step, 250) % 2))
        moving, still = (evaluate([script], 1000).movement[:, 0] for script in (stops, Script()))
        np.testing.assert_allclose(moving, [0.1, 0.0], atol=0.05)  # the action, seen in the third component, changes
        assert moving[0] > moving[1] + 0.05
        np.testing.assert_allclose(still, 0.0, atol=0.05)

    def test_is_unknown_for_a_episode_that_ended_before(self):
        assert np.isnan(evaluate([Script(falls_at=50)], 1000).movement[1, 0])


class TestDetails:
    def test_the_component_that_leaves_its_training_range_first_is_named(self):
        low, high = np.array([-1.0, -1.0, -1.0]), np.array([1.0, 1.0, 1.0])
        reference = Reference(10, np.zeros((1, 1)), np.array([10]), np.array([False]), low, high)
        policy = dataclasses.replace(policy_for(SCRIPTED), reference=reference)
        scripts = [Script(place=lambda step: 0.01 * step), Script()]
        episodes = [EpisodeSpec(0, None, seed, steps=500) for seed in range(2)]
        records = evaluate_episodes([policy], episodes, world=world_of(scripts))
        # The range is [-1, 1]; half of it further out is 2, reached at step 200.
        assert records.end_detail == ["observation[1] left its training range at step 210", ""]
        world = world_of(scripts)
        world.spec = dataclasses.replace(world.spec, observation_names=("a", "pitch", "c"))
        named, _ = evaluate_episodes([policy], episodes, world=world).end_detail
        assert named == "observation[1] (pitch) left its training range at step 210"

    def test_without_reference_episodes_nothing_is_said(self):
        assert evaluate([Script(place=lambda step: 0.01 * step)], 500).end_detail == [""]

    @pytest.mark.parametrize(
        ("script", "sign"),
        [
            (Script(reward=lambda step: math.nan if step == 20 else 1.0), "a reward that is not finite"),
            (Script(reward=lambda step: 5e4 if step == 20 else 1.0), "an impossible reward of 5e+04"),
            (Script(place=lambda step: math.inf if step == 20 else 0.0), "an observation that is not finite"),
            (Script(place=lambda step: 0.5 * step if step < 20 else 0.0), "put back to its start within a step"),
        ],
    )
    def test_a_divergence_names_its_sign(self, script, sign):
        records = evaluate([script], 100)
        assert (END_REASONS[records.end_reason[0]], records.end_detail[0]) == ("diverged", sign)


def test_a_world_of_the_caller_stays_open():
    world = world_of([Script()])
    evaluate_episodes([policy_for(SCRIPTED)], [EpisodeSpec(0, None, 0, steps=5)], world=world)
    assert world.reset().shape == (1, 3)


@pytest.mark.parametrize(
    ("episodes", "message"),
    [
        ([], "no episode to evaluate"),
        ([EpisodeSpec(1, None, 0)], "an index into 1 policies, from 0, got 1"),
        ([EpisodeSpec(-1, None, 0)], "an index into 1 policies, from 0, got -1"),
        ([EpisodeSpec(0, None, 0, steps=0)], "steps must be at least 1, got 0"),
        ([EpisodeSpec(0, None, 0, steps=steps) for steps in (5, 6)], "must have the same steps"),
    ],
)
def test_episodes_that_cannot_be_run_are_refused(episodes, message):
    with pytest.raises(PerdureError, match=message):
        evaluate_episodes([policy_for(SCRIPTED)], episodes)


SCALE = ScoreScale(0.0, 1.0, math.nan, 4, "worked", "")


@pytest.fixture(scope="module")
def frame(records):
    episodes = [EpisodeSpec(0, None, seed, steps=STEPS) for seed in range(len(SCRIPTS))]
    raw = with_not_applied(episode_table(["p"], [policy_for(SCRIPTED)], episodes, records), [])
    return judge_table(raw, {("p", 0): SCALE})


class TestTable:
    def test_has_one_row_for_each_episode_and_recorded_step(self, frame):
        assert frame.height == len(SCRIPTS) * STEPS
        assert frame.select("eval_seed", "step").is_unique().all()

    def test_a_episode_is_alive_at_the_steps_it_completed_without_ending(self, frame):
        alive = frame.filter("alive").group_by("eval_seed").agg(pl.col("step").max()).sort("eval_seed")
        assert alive["eval_seed"].to_list() == [0, 1, 2, 3, 4, 5, 7], "episode 6 fell with its first step"
        assert alive["step"].to_list() == [40, 6, 19, 19, 39, 40, 37]

    def test_every_episode_has_a_verdict(self, frame):
        episodes = frame.filter(pl.col("step") == STEPS).sort("eval_seed")
        assert episodes["outcome"].to_list() == ["holds", "falls", "cut", "falls", "falls", "holds", "falls", "falls"]
        assert episodes["failed_step"].to_list() == [40, 7, 20, 20, 40, 40, 1, 2], (
            "the last one is no better than idle in every window"
        )
        assert set(episodes["policy_state"]) == {"worked"}

    def test_is_accepted_by_the_report_and_comes_back_from_its_file(self, frame, tmp_path):
        path = write_table(tmp_path / "episodes.parquet", frame, {"command": "none"})
        found, metadata = read_table(path)
        assert metadata["command"] == "none"
        assert found.sort("eval_seed", "step").select(frame.columns).equals(frame.sort("eval_seed", "step"))
