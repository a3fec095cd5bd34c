"""Counting from records against both definitions written out, and denominators worked out by hand."""

import math
from dataclasses import replace

import numpy as np
import polars as pl
import pytest
from home_stories import Story, good, random_log
from hypothesis import given, settings
from hypothesis import strategies as st
from polars.testing import assert_frame_equal
from test_failure_modes import OUT, gone_in_the_end, missed, placed_and_gone

import perdure.home.evaluate.log as history
from perdure.errors import PerdureError
from perdure.home.evaluate.analysis import SAME_PLACEMENT, STAYED, analyze, paired_difference
from perdure.home.evaluate.comparison import by_shape, make_views
from perdure.home.evaluate.outcomes import (
    COUNTINGS,
    FAILURE_CAUSES,
    final_state,
    label,
    latched,
    placement,
    stabilizing,
)
from perdure.home.evaluate.page import summary_text
from perdure.home.evaluate.strategy import Strategy

seeds = st.integers(0, 2**32 - 1)
TASKS = ("prepare_groceries", "tidy_house", "set_table")


def brute_force(log):
    """Goal-stabilizing as the thesis writes it, step by step."""
    counts = []
    for target, goal in enumerate(log.history.facts.goal_positions):
        mine = [run for run in log.runs if run.target == target and run.skill in ("pick", "place")]
        placed = bool(mine) and mine[-1].skill == "place"
        begin, end = (mine[0].begin, mine[-1].end if placed else log.steps) if mine else (0, 0)
        handled = range(begin, end) if mine and mine[0].skill == "pick" else ()
        counts.append(
            bool(handled)
            and all(
                math.dist(log.history.facts.object_positions[step, target], goal) <= 0.15
                and log.history.facts.held[step] != target
                for step in range(handled[-1] + 1, len(log.history.facts))
            )
        )
    return tuple(counts)


@settings(max_examples=60, deadline=None)
@given(seeds, st.sampled_from(TASKS))
def test_goal_stabilizing_from_a_record_is_the_definition(seed, task):
    log = random_log(np.random.default_rng(seed), task=task)
    record = log
    expected = (False,) * len(record.targets) if log.diverged else brute_force(log)
    assert stabilizing(record) == expected


def test_random_logs_hold_placements_of_both_kinds():
    found = [stabilizing(random_log(np.random.default_rng(seed))) for seed in range(40)]
    assert 0.1 < np.mean(found) < 0.9


@settings(max_examples=25, deadline=None)
@given(seeds, st.sampled_from(TASKS))
def test_every_failed_episode_has_one_label_and_labels_add_up(seed, task):
    rng = np.random.default_rng(seed)
    records = [random_log(rng, index, task) for index in range(3)]
    analysis = analyze(records)
    for counting in COUNTINGS:
        labels = [label(record, counting) for record in records]
        wins = analysis.episodes["success" if counting == "latched" else "stabilizing"]
        assert [found is None for found in labels] == wins.to_list()
        assert {found.cause for found in labels if found} <= set(FAILURE_CAUSES)
        failed = 3 - wins.sum()
        modes = analysis.modes.filter(counting=counting)
        assert modes["count"].sum() == failed == len(analysis.failures.filter(counting=counting))
        assert modes["of_all"].sum() == pytest.approx(failed / 3)
        assert modes["of_failed"].sum() == pytest.approx(1.0 if failed else 0.0)
    assert analysis.outcomes["count"].sum() == 3
    lost = analysis.outcomes.filter(outcome="success that did not last")["count"].sum()
    both = analysis.episodes
    assert lost == (both["success"] & ~both["stabilizing"]).sum()


@settings(max_examples=15, deadline=None)
@given(seeds, st.permutations(range(4)))
def test_the_order_of_episodes_changes_nothing(seed, order):
    rng = np.random.default_rng(seed)
    records = [random_log(rng, index) for index in range(4)]
    one, other = analyze(records), analyze([records[k] for k in order])
    for name in vars(one):
        assert_frame_equal(getattr(one, name), getattr(other, name), check_exact=True)
    assert summary_text(one) == summary_text(other)


@settings(max_examples=25, deadline=None)
@given(seeds, st.sampled_from(TASKS))
def test_steps_left_out_of_tracks_change_no_label(seed, task):
    log = random_log(np.random.default_rng(seed), task=task)
    thin = log
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(history, "kept_steps", lambda position, up: np.arange(len(up)))
        dense = random_log(np.random.default_rng(seed), task=task)
    assert [label(thin, c) for c in COUNTINGS] == [label(dense, c) for c in COUNTINGS]


@settings(max_examples=25, deadline=None)
@given(seeds, st.sampled_from(TASKS))
def test_stages_counted_from_events_are_those_of_every_step(seed, task):
    log = random_log(np.random.default_rng(seed), task=task)
    met = np.stack([stage.met(log.history.facts) for stage in log.home_task.stages], axis=-1)
    reached = np.zeros(met.shape[1], dtype=bool)
    for now in met[: log.steps]:
        reached = np.logical_and.accumulate(reached | now)
    assert latched(log) == tuple(reached)


def test_a_log_that_does_not_say_what_was_run_is_refused():
    with pytest.raises(PerdureError, match="no place"):
        replace(good(), place="")


def ten_episodes():
    """4 successes, 1 that did not last, 3 that lost object 0, 2 that missed the first grasp."""
    logs = [good(index, seed) for index in (0, 1) for seed in (0, 1)]
    logs.append(Story(index=2).rest(range(3)).log(meanwhile=gone_in_the_end))
    logs += [placed_and_gone(**how).log() for how in ({}, {}, {"then": {"tilt": 90.0}})]
    logs += [missed(Story(), 0).log(), missed(Story(), 0, gripper=0.3).log()]
    seeded = [(0, 100), (1, 100), (0, 101), (1, 101)]
    return [replace(log, train_seed=100 + number) for number, log in enumerate(logs, start=len(seeded))]


@pytest.fixture(scope="module")
def ten():
    return analyze(ten_episodes())


def test_both_denominators_as_worked_out_by_hand(ten):
    rows = ten.modes.filter(counting="latched").select("stage", "cause", "count", "of_all", "of_failed").rows()
    assert rows == [
        ("pick_0", "not reached", 1, 0.1, 0.2),
        ("pick_0", "grasp missed", 1, 0.1, 0.2),
        ("pick_1", "tipped", 1, 0.1, 0.2),
        ("pick_1", "rolled", 2, 0.2, 0.4),
    ]
    stable = ten.modes.filter(counting="stabilizing").select("stage", "cause", "count", "of_all").rows()
    assert ("place_2", "rolled", 1, 0.1) in stable
    assert ("place_0", "rolled", 2, 0.2) in stable
    assert sum(row[2] for row in stable) == 6


def test_outcomes_as_worked_out_by_hand(ten):
    assert ten.outcomes.select("outcome", "count", "of_all", "of_failed").rows() == [
        ("success", 4, 0.4, None),
        ("success that did not last", 1, 0.1, None),
        ("place_0", 3, 0.3, 0.6),
        ("place_1", 0, 0.0, 0.0),
        ("place_2", 0, 0.0, 0.0),
        ("other", 2, 0.2, 0.4),
    ]


def test_success_over_runs_as_worked_out_by_hand():
    """Runs (100, 0): 2 of 2; (100, 1): 1 of 2; (101, 0): 1 of 2; (101, 1): 0 of 2. s^2 = (1/4 + 1/4) / 3."""
    wins = {(100, 0): 2, (100, 1): 1, (101, 0): 1, (101, 1): 0}
    records = []
    for (train, evaluation), won in wins.items():
        for index in range(2):
            story = Story(index=index, eval_seed=evaluation)
            story = story.rest(range(3)) if index < won else missed(story, 0)
            records.append(replace(story.log(), train_seed=train))
    (row,) = analyze(records).stages.filter(counting="latched", stage="place_2").rows(named=True)
    assert (row["episodes"], row["runs"], row["mean"]) == (8, 4, 0.5)
    assert row["standard_error"] == pytest.approx(math.sqrt(0.5 / 3) / 2)
    assert np.isnan([row["lower"], row["upper"]]).all(), "two training seeds have no interval"
    assert (row["units"], row["method"]) == ("training seeds", "Student t")


def test_four_successes_of_four_are_no_certainty():
    stages = analyze([good(index) for index in range(4)]).stages
    assert (stages["mean"] == 1.0).all()
    assert stages["lower"].to_list() == pytest.approx([0.025**0.25] * len(stages))  # Clopper-Pearson


def test_an_episode_that_several_evaluation_seeds_begin_counts_once():
    """Four episodes, each begun three times: as sure as four, not as twelve."""
    logs = [Story(index=index, eval_seed=seed).rest(range(3)).log() for index in range(4) for seed in range(3)]
    found = analyze(logs)
    assert found.stages["lower"].to_list() == pytest.approx([0.025**0.25] * len(found.stages))
    assert paired_difference(found.episodes, found.episodes).count == 4
    unequal = [log for log in logs if log.index == 0] + [missed(Story(index=index), 0).log() for index in range(1, 4)]
    (row,) = analyze(unequal).stages.filter(counting="latched", stage="place_2").rows(named=True)
    assert (row["mean"], row["lower"] < 0.25 < row["upper"]) == (0.25, True), "seeds that were not finished"


def test_one_run_has_no_standard_error_and_names_its_units_and_method():
    stages = analyze([good(index) for index in range(3)]).stages
    assert stages["standard_error"].is_nan().all()
    assert set(stages.select("units", "method").rows()) == {("evaluation seeds only", "Clopper-Pearson")}


def test_an_episode_that_is_there_twice_is_refused():
    records = [good()] * 2
    with pytest.raises(PerdureError, match="twice"):
        analyze(records)
    with pytest.raises(PerdureError, match="at least one"):
        analyze([])


def test_two_strategies_do_not_mix():
    records = [replace(good(), place="a"), replace(missed(Story(), 0).log(), place="b")]
    analysis = analyze(records)
    final = analysis.stages.filter(counting="latched", stage="place_2")
    assert dict(final.select("place", "mean").rows()) == {"a": 1.0, "b": 0.0}
    assert set(analysis.modes["place"]) == {"b"}
    assert set(analysis.modes["of_all"]) == {1.0}


def test_placements_say_how_the_object_was_let_go():
    story = Story().go(0, above=0.05, beside=0.06, tilt=30.0, speed=0.2, way=0.01)
    story.slide(0, OUT, 10).rest((1, 2))
    table = analyze([story.log()]).placements
    assert table["target"].to_list() == [0, 1, 2]
    row = table.row(0, named=True)
    expected = {"release_height": 0.05, "release_offset": 0.06, "tilt": 30.0, "object_speed": 0.2, "base_speed": 0.3}
    assert {name: row[name] for name in expected} == pytest.approx(expected, abs=0.02)
    assert row["gripper_speed"] == pytest.approx(0.3)
    assert (row["displacement"], row["fall"]) == pytest.approx((0.3, 0.05), abs=1e-3)
    places = ("release", "skill_end", "end", "settled")
    assert [row[f"in_goal_{each}"] for each in places] == [True, True, False, False]
    assert row["place_step"] == 4, "steps of the story's place before the hand opens"
    late = [replace(run, begin=run.begin + 4) if run.skill == "place" else run for run in story.log().runs]
    assert set(analyze([replace(story.log(), runs=tuple(late))]).placements["place_step"]) == {0}, "in its first step"
    assert (row["skill"], row["forced"], row["stabilizing"], row["cause"]) == ("place", False, False, "rolled")
    assert table["cause"].to_list()[1:] == ["stayed"] * 2


def test_placements_tell_the_end_of_the_skill_from_that_of_the_episode_and_of_the_settling_time():
    story = Story().go(0).slide(0, OUT, 1).rest((1, 2))
    rows = analyze([story.log(meanwhile=gone_in_the_end)]).placements.rows(named=True)
    ends = [[row[f"in_goal_{each}"] for each in ("skill_end", "end", "settled")] for row in rows]
    assert ends == [[True, False, False], [True, True, True], [True, True, False]]


def test_an_object_that_was_never_let_go_is_no_placement():
    assert len(analyze([missed(Story(), 0).log()]).placements) == 0


def test_cylinders_are_counted_beside_their_share_of_placements():
    """Object by object: the share of failures is hand-counted from the kinds of the episodes used."""
    from home_stories import episodes

    logs, cylinders, failures = [], [], []
    for index in range(4):
        story = Story(index=index)
        can = [goal.kind[:3] in ("002", "005", "007") for goal in episodes("prepare_groceries")[index].goals]
        for target in range(3):
            story.go(target)
        for target in range(3):
            if can[target]:
                story.slide(target, OUT, 10)
        logs.append(story.log())
        cylinders += can
        failures += can
    (view,) = make_views(vars(analyze(logs)))
    assert 0 < sum(cylinders) < 12
    assert by_shape(view, Strategy("story")) == ((sum(cylinders), sum(failures)), (12 - sum(cylinders), 0))


def test_kinds_hold_counts_and_rates_that_add_up(ten):
    assert ten.kinds["placements"].sum() == len(ten.placements)
    assert ten.kinds["failures"].sum() == (~ten.placements["stabilizing"]).sum() == 4
    assert ten.kinds.select((pl.col("rate") * pl.col("placements") - pl.col("failures")).abs().max()).item() < 1e-12


def test_the_summary_holds_what_the_tables_hold(ten):
    text = summary_text(ten)
    for part in ("counted, did not last", "1 of 5", "2 (20.0 %, 33.3 %)", "grasp missed", "place_2", "4 of 24"):
        assert part in text


def test_latched_from_a_record_is_the_benchmarks():
    assert latched(placed_and_gone().log()) == (True, True, False, False, False, False)


def out_and_back(story):
    story.slide(0, OUT, 1).slide(0, tuple(-each for each in OUT), 1)


def repaired(again=True):
    """Object 0 leaves its goal while object 1 is handled; it is picked and placed again, well or not."""
    story = Story().go(0).pick(1).slide(0, OUT, 10).place(1)
    return (story.go(0) if again else story.pick(0).place(0, beside=0.3)).rest([2]).log()


def test_a_repaired_placement_counts_and_a_bad_repair_does_not():
    assert stabilizing(repaired()) == (True, True, True)
    assert final_state(repaired())
    assert stabilizing(repaired(again=False)) == (False, True, True)
    assert not final_state(repaired(again=False))
    assert repaired().run("place", 0).attempt == 2


def test_the_placements_of_a_plan_that_looks_again_are_the_first_ones():
    """Else those that did not stay would be replaced by those that did."""
    tables = analyze([repaired()])
    assert tables.episodes["stabilizing"].to_list() == [True]
    placed = tables.placements.select("target", "stabilizing", "cause", "in_goal_skill_end", "in_goal_end").rows()
    assert placed == [(0, False, "rolled", True, True), (1, True, STAYED, True, True), (2, True, STAYED, True, True)]
    assert placement(repaired(), 0).step > placement(repaired(), 1).step > placement(repaired(), 0, once=True).step


def test_logs_of_the_oracle_are_no_training_seed_of_a_policy():
    learned = repaired()
    with pytest.raises(PerdureError, match="val story: with and without learned policies; analyze them apart"):
        analyze([learned, replace(learned, train_seed=history.UNTRAINED)])


def test_the_final_state_is_that_of_the_last_five_seconds():
    assert final_state(good())
    late = Story().rest(range(3)).log(settle=200, meanwhile=out_and_back)
    assert final_state(late), "198 steps after the object has come back"
    assert not final_state(Story().rest(range(3)).log(meanwhile=gone_in_the_end))
    assert not final_state(Story().rest(range(2)).pick(2).log())


def test_a_final_state_lasts_five_seconds_with_an_empty_hand():
    held = Story().rest(range(3))
    held.held = 2
    assert not final_state(held.log())
    for settle, lasts in ((149, True), (148, False)):
        assert final_state(Story().rest(range(3)).log(settle=settle, meanwhile=out_and_back)) == lasts


def test_what_the_oracle_helped_with_is_not_unaided():
    log = Story().rest(range(3)).log()
    helped = replace(log, index=1, runs=(replace(log.runs[0], scripted=True), *log.runs[1:]))
    row = analyze([log, helped, missed(Story(index=2), 0).log()]).success.row(0, named=True)
    assert (row["final"], row["unaided"]) == (2, 1)


def test_episodes_and_placements_hold_what_the_log_says():
    log = Story().go(0, forced=True, force=700.0).rest((1, 2)).log()
    tables = analyze([log])
    assert tables.placements["forced"].to_list() == [True, False, False]
    assert tables.episodes.select("seconds", "force").row(0) == (log.steps / 30, 700.0)


def test_placements_of_an_episode_are_one_unit_and_so_are_its_evaluation_seeds():
    logs = [Story(index=k, eval_seed=seed).rest(range(3)).log() for seed, k in [(0, 0), (0, 1), (0, 2), (0, 3), (1, 0)]]
    found = analyze(logs)
    assert paired_difference(found.episodes, found.episodes).count == 4
    assert paired_difference(found.placements, found.placements, keys=SAME_PLACEMENT).count == 4
    (view,) = make_views({name: getattr(found, name) for name in ("success", "episodes")})
    assert view.units(Strategy("story")) == (False, 4), "an evaluation seed is not finished"
