"""Claims are decided as they must be on tables of known answer."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import get_args

import pytest
from known_results import make_results

from perdure.stats import Difference
from studies.horizon.claims import (
    MEASURES,
    Claim,
    Condition,
    Direction,
    by_interval,
    claims_frame,
    decide_claims,
    mean_over_tasks,
    read_claims,
    threshold,
)
from studies.horizon.grid import GRIDS

TASK = "Hopper-v3"
PPO, NONE = Condition("ppo"), {seed: 100.0 + seed for seed in range(5)}
FAR = {seed: 200.0 + seed for seed in range(5)}
WIDE = {0: 0.0, 1: 50.0, 2: 100.0, 3: 150.0, 4: 220.0}


def claim(direction="greater", **parts):
    settings = {"tasks": (TASK,), "left": Condition("geometric", "constant:500"), "right": PPO} | parts
    return Claim("x", "a test", "A sentence.", direction=direction, **settings)


def decided(left, *claims, right=NONE):
    results = make_results({("ppo", "none"): right, ("geometric", "constant:500"): left})
    return [each.decision for each in decide_claims(claims, results.values)]


@pytest.mark.parametrize(
    ("left", "direction", "margin", "expected"),
    [
        (FAR, "greater", 0.0, "supported"),
        (FAR, "less", 0.0, "contradicted"),
        (FAR, "not less", 0.0, "supported"),
        (FAR, "differs", 0.0, "supported"),
        (FAR, "same", 0.1, "contradicted"),
        (FAR, "greater", 2.0, "contradicted"),  # it is greater by 98 %, not by more than 200 %
        (WIDE, "greater", 0.0, "undecided"),
        (WIDE, "differs", 0.0, "undecided"),
        (WIDE, "same", 0.1, "undecided"),
        (NONE, "same", 0.1, "supported"),
        (NONE, "not less", 0.1, "supported"),
        (NONE, "differs", 0.1, "contradicted"),
    ],
)
def test_decisions(left, direction, margin, expected):
    assert decided(left, claim(direction, margin=margin)) == [expected]


BOUNDS = {
    "above": (2.0, 3.0),
    "below": (-3.0, -2.0),
    "within": (-0.5, 0.5),
    "across the upper margin": (0.5, 2.0),
    "across the lower margin": (-2.0, -0.5),
    "from the upper margin on": (1.0, 3.0),
    "up to the lower margin": (-3.0, -1.0),
    "from margin to margin": (-1.0, 1.0),
    "unknown": (math.nan, math.nan),
}
"""95 % intervals beside a margin of 1."""
YES, NO, OPEN = "supported", "contradicted", "undecided"
BY_INTERVAL = {
    "greater": (YES, NO, NO, OPEN, NO, OPEN, NO, NO, OPEN),
    "less": (NO, YES, NO, NO, OPEN, NO, OPEN, NO, OPEN),
    "not less": (YES, NO, YES, YES, OPEN, YES, OPEN, YES, OPEN),
    "differs": (YES, YES, NO, OPEN, OPEN, OPEN, OPEN, NO, OPEN),
    "same": (NO, NO, YES, OPEN, OPEN, OPEN, OPEN, YES, OPEN),
}


@pytest.mark.parametrize("direction", BY_INTERVAL)
def test_an_interval_decides_by_where_it_lies_beside_the_margin(direction):
    for (where, (lower, upper)), expected in zip(BOUNDS.items(), BY_INTERVAL[direction], strict=True):
        found = by_interval(claim(direction), SimpleNamespace(lower=lower, upper=upper), 1.0)
        assert (where, found) == (where, expected)


@pytest.mark.parametrize(
    ("direction", "estimate", "expected"),
    [
        ("greater", -3.0, 1.0),
        ("less", 3.0, -1.0),
        ("not less", 3.0, -1.0),
        ("differs", 3.0, 1.0),
        ("differs", -3.0, -1.0),
        ("same", -0.5, -1.0),
    ],
)
def test_the_p_value_is_that_of_the_margin_that_the_decision_turns_on(direction, estimate, expected):
    assert threshold(claim(direction), SimpleNamespace(estimate=estimate), 1.0) == expected


def test_a_margin_is_a_share_of_the_size_of_the_right_side():
    """Returns of about -102 and a margin of a tenth: 10.2, not -10.2."""
    right = {seed: -100.0 - seed for seed in range(5)}
    left = {seed: -104.0 - seed for seed in range(5)}
    results = {("ppo", "none"): right, ("geometric", "constant:500"): left}
    for direction, expected in (("not less", YES), ("same", YES), ("greater", NO)):
        (found,) = decide_claims([claim(direction, margin=0.1)], make_results(results).values)
        assert found.tasks[0].margin == pytest.approx(10.2)
        assert found.decision == expected


def test_a_margin_of_shares_is_itself():
    half = {0: None, 1: None, 2: 100.0, 3: 100.0}
    results = {("ppo", "none"): half, ("geometric", "constant:500"): dict.fromkeys(range(4), 100.0)}
    (found,) = decide_claims([claim("same", measure="failed share", margin=0.1)], make_results(results).values)
    assert found.tasks[0].difference.right == 0.5
    assert found.tasks[0].margin == 0.1


def test_a_mean_over_tasks_is_of_differences_beside_the_size_of_the_right_side():
    def difference(left, right):
        return Difference(left, right, 1.0, 4.0, 0.5, 5, 5, "Welch t")

    mean = claim("greater", over="mean")
    found = mean_over_tasks(mean, [difference(30.0, 20.0), difference(-90.0, -100.0)])
    assert found.estimate == pytest.approx((10.0 / 20.0 + 10.0 / 100.0) / 2.0)
    shares = mean_over_tasks(replace(mean, measure="failed share"), [difference(0.3, 0.2), difference(0.9, 0.4)])
    assert shares.estimate == pytest.approx(0.3)
    assert mean_over_tasks(mean, [difference(30.0, 20.0), None]) is None
    assert mean_over_tasks(mean, [difference(30.0, 20.0), difference(1.0, 0.0)]) is None


@pytest.mark.parametrize("number", [0.5, 0.1])
@pytest.mark.parametrize(
    ("runs", "expected"),
    [(3, ["undecided", "undecided"]), (5, ["undecided", "undecided"]), (6, ["supported", "contradicted"])],
)
def test_runs_without_spread_are_decided_by_their_number(runs, expected, number):
    """All runs fell: a sign test of five has p = 2 / 2^5 = 0.0625, of six 0.031."""
    fallen = dict.fromkeys(range(runs))
    claims = [claim(way, right=number, measure="failed share", margin=0.1) for way in ("greater", "less")]
    results = make_results({("ppo", "none"): dict.fromkeys(range(runs), 1.0), ("geometric", "constant:500"): fallen})
    found = decide_claims(claims, results.values)
    assert [each.decision for each in found] == expected


def test_clocks_of_one_training_run_are_paired():
    together = {("geometric", "constant:100"): {s: 100.0 * s for s in range(5)}}
    together[("geometric", "constant:500")] = {s: 100.0 * s + 5.0 + 0.1 * s for s in range(5)}
    results = make_results(together)
    one = claim(right=Condition("geometric", "constant:100"))
    (found,) = decide_claims([one], results.values)
    assert found.decision == "supported"
    assert found.tasks[0].difference.method == "paired t"


def test_what_is_not_evaluated_decides_nothing():
    results = make_results({("ppo", "none"): NONE})
    (found,) = decide_claims([claim()], results.values)
    assert (found.decision, found.after_holm) == ("not evaluated", "not evaluated")


def test_each_task_and_the_mean_over_tasks():
    results = make_results({("ppo", "none"): NONE, ("geometric", "constant:500"): FAR})
    found = decide_claims([claim(tasks=(TASK, "Ant-v3")), claim(over="mean")], results.values)
    assert [each.decision for each in found] == ["undecided", "supported"]
    assert found[1].pooled.estimate == pytest.approx(100.0 / 102.0)


def test_a_mean_over_tasks_without_spread_is_not_decided_by_an_interval_of_width_0():
    same = {("ppo", "none"): dict.fromkeys(range(3), 0.0), ("geometric", "constant:500"): dict.fromkeys(range(3), 1.0)}
    results = make_results(same, tasks=("Swimmer-v3", "Ant-v3"))
    (found,) = decide_claims(
        [claim(tasks=("Swimmer-v3", "Ant-v3"), over="mean", measure="score vs published")], results.values
    )
    assert (found.pooled.error, found.decision) == (0.0, "undecided")


def test_holm_counts_all_comparisons():
    """One comparison with p = 0.03 stands alone, and falls among many."""
    left = {0: 106.0, 1: 105.0, 2: 110.0, 3: 102.0, 4: 113.0}
    right = {0: 100.0, 1: 103.0, 2: 99.0, 3: 98.0, 4: 104.0}
    results = make_results({("ppo", "none"): right, ("geometric", "constant:500"): left})
    (alone,) = decide_claims([claim()], results.values)
    assert 0.02 < alone.tasks[0].p < 0.05
    assert alone.after_holm == "supported"
    among = decide_claims([claim()] * 5, results.values)
    assert {each.decision for each in among} == {"supported"}
    assert {each.after_holm for each in among} == {"undecided"}


def test_the_chosen_clock_is_that_of_the_validation_start_states():
    clocks = [("geometric", f"constant:{steps}") for steps in (100, 200)]
    test = {clocks[0]: {0: 1.0, 1: 9.0, 2: 9.0}, clocks[1]: {0: 5.0, 1: 4.0, 2: 4.0}}
    validation = {clocks[0]: dict.fromkeys(range(3), 0.0), clocks[1]: dict.fromkeys(range(3), 1.0)}
    results = make_results(test, validation)
    assert results.values(TASK, Condition("geometric", "chosen")) == {0: 5.0, 1: 4.0, 2: 4.0}
    assert results.values(TASK, Condition("geometric", "best")) == {0: 1.0, 1: 9.0, 2: 9.0}


def test_the_chosen_clock_is_used_for_each_run():
    clocks = {
        ("geometric", "constant:100"): {0: 1.0, 1: 9.0, 2: 9.0},
        ("geometric", "constant:200"): {0: 5.0, 1: 4.0, 2: 4.0},
    }
    results = make_results(clocks)
    # Without seed 0 constant:100 is best (9 against 4); without seed 1 or 2 too (5 against 4.5).
    assert results.values(TASK, Condition("geometric", "chosen")) == {0: 1.0, 1: 9.0, 2: 9.0}
    assert results.values(TASK, Condition("geometric", "best")) == {0: 1.0, 1: 9.0, 2: 9.0}


def test_a_mean_over_tasks_has_a_row_of_its_own():
    tasks = ("Swimmer-v3", "Ant-v3")
    results = make_results({("ppo", "none"): NONE, ("geometric", "constant:500"): FAR}, tasks=tasks)
    rows = claims_frame(decide_claims([claim(tasks=tasks, over="mean")], results.values))
    assert rows.select("task", "decision", "after Holm").rows() == [
        ("Swimmer-v3", "supported", None),
        ("Ant-v3", "supported", None),
        ("mean of the tasks", "supported", "supported"),
    ]


def test_claims_registered_apart_are_corrected_apart():
    left = {0: 106.0, 1: 105.0, 2: 110.0, 3: 102.0, 4: 113.0}
    right = {0: 100.0, 1: 103.0, 2: 99.0, 3: 98.0, 4: 104.0}
    results = make_results({("ppo", "none"): right, ("geometric", "constant:500"): left})
    among = [*[claim()] * 5, claim(registered="later")]
    assert [each.after_holm for each in decide_claims(among, results.values)] == [*["undecided"] * 5, "supported"]


def test_registered_claims_are_about_methods_and_tasks_of_the_grid():
    claims = read_claims()
    assert len({each.id for each in claims}) == len(claims) == 27
    assert [each.registered for each in claims] == [*["first"] * 22, *["pilots"] * 5]
    settings = set(GRIDS["thesis"].settings)
    methods = {row.method for row in GRIDS["thesis"].rows}
    for each in claims:
        assert set(each.tasks) <= settings
        assert each.tasks
        assert each.margin >= 0.0
        assert each.direction in get_args(Direction)
        assert each.measure in MEASURES
        assert each.over in ("each", "mean")
        assert {side.method for side in (each.left, each.right) if isinstance(side, Condition)} <= methods
