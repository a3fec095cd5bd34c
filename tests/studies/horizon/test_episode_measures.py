"""Measures of episodes and training runs, against tables whose episodes were written down by hand."""

import pytest
from known_results import HORIZON, episodes, make_results, table

from studies.horizon.results import VALIDATION, freeze_episodes, measure, name_clocks


def measured(*parts, **changes):
    return measure(freeze_episodes(table(*parts, **changes), "Hopper-v3", "geometric", "test")).to_dicts()[0]


def test_a_episode_that_holds():
    found = measured(episodes("geometric", "constant:500", 0, 2000, 3000.0))
    assert (found["return"], found["failed share"]) == (3000.0, 0.0)
    assert (found["steps to failure"], found["verdict"]) == (HORIZON, "holds")
    assert found["training score vs published"] == pytest.approx(0.5)  # 1.5 a step, idle 0, published policy 3
    assert found["score vs published"] == pytest.approx(1.0)


def test_the_gain_pays_nothing_for_standing_still_and_counts_the_steps_before_a_fall():
    still = measured(episodes("geometric", "none", 0, 2000, 1000.0), idle_rate=1.0)
    assert still["score vs published"] == pytest.approx(0.0)
    falling = measured(episodes("geometric", "none", 0, 2000, 30.0, falls=True), idle_rate=1.0)
    assert falling["score vs published"] == pytest.approx((30.0 - 10.0) / ((3.0 - 1.0) * HORIZON))


def test_a_episode_that_falls():
    found = measured(episodes("geometric", "constant:500", 0, 2000, 30.0, falls=True))
    assert (found["return"], found["failed share"]) == (30.0, 1.0)
    assert (found["steps to failure"], found["verdict"]) == (10, "falls")


def test_a_policy_that_never_worked_has_failed_from_the_start():
    found = measured(
        episodes("geometric", "constant:500", 0, 2000, 30.0), policy_state="never worked", outcome="unknown"
    )
    assert (found["verdict"], found["failed share"], found["steps to failure"]) == ("never worked", 1.0, 0)


def test_where_it_cannot_be_told_nothing_is_called_a_failure_or_a_success():
    surviving = measured(episodes("geometric", "none", 0, 2000, 30.0), policy_state="cannot tell", outcome="unknown")
    fallen = measured(episodes("geometric", "none", 0, 2000, 30.0, falls=True), policy_state="cannot tell")
    for found in (surviving, fallen):
        assert (found["failed share"], found["steps to failure"]) == (None, None)


def test_a_silent_failure_counts_from_its_first_step():
    found = measured(
        episodes("geometric", "none", 0, 2000, 30.0),
        outcome="fails silently",
        failed_step=400,
        end_score_vs_training=0.1,
    )
    assert (found["failed share"], found["steps to failure"]) == (1.0, 400)


def test_clocks_are_named_as_on_a_command_line():
    clocks = ("none", "constant:500", "periodic:300", "countdown", "countdown:200")
    names = name_clocks(table(*(episodes("geometric", clock, 0, 2000, 1.0) for clock in clocks)))["clock"].unique(
        maintain_order=True
    )
    assert names.to_list() == list(clocks)


def test_episodes_are_averaged_within_training_runs():
    runs = make_results({("geometric", "constant:500"): {0: 1.5, 1: 101.5}}).runs.filter(split="test")
    assert runs.select("train_seed", "episodes", "return").rows() == [(0, 2, 1.5), (1, 2, 101.5)]


def test_start_states_of_other_splits_are_left_out():
    results = make_results({("geometric", "constant:500"): {0: 1.0, 1: 2.0}})
    states = {split: set(part["eval_seed"]) for (split,), part in results.episodes.group_by("split")}
    assert states == {"test": {2000, 2001}, "validation": {1000}}
    assert len(results.of("Hopper-v3", "geometric", VALIDATION)) == 2


def test_curves_hold_the_return_so_far():
    frozen = freeze_episodes(table(episodes("ppo", "none", 0, 2000, 30.0, falls=True)), "Hopper-v3", "ppo", "test")
    assert frozen["curve_steps"].to_list() == [[10, 900, 1000]]
    assert frozen["curve"].to_list() == [[30.0, 30.0, 30.0]]
