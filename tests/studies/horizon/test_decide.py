"""Claims are decided as they must be on tables of known answer."""

import math
import tempfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from known_results import make_results

from perdure.studies import StudyError
from perdure.studies.comparison import Difference, compare_unpaired, compare_with
from perdure.studies.horizon.claim import Claim, Condition
from perdure.studies.horizon.claim_table import claims_frame, claims_text, runs_needed
from perdure.studies.horizon.decide import by_interval, decide_claims, mean_over_tasks, threshold
from perdure.studies.horizon.grid import ZOO, Row
from perdure.studies.horizon.page import write_page

TASK = "Hopper-v3"
PPO, NONE = Condition("ppo"), {seed: 100.0 + seed for seed in range(5)}
FAR = {seed: 200.0 + seed for seed in range(5)}
WIDE = {0: 0.0, 1: 50.0, 2: 100.0, 3: 150.0, 4: 220.0}


def claim(direction="greater", **parts):
    settings = {"tasks": (TASK,), "left": Condition("geometric", "constant:500"), "right": PPO} | parts
    return Claim("x", "a test", "A sentence.", direction=direction, **settings)


def decided(tmp_path, left, *claims, right=NONE):
    results = make_results(tmp_path, {("ppo", "none"): right, ("geometric", "constant:500"): left})
    return [each.decision for each in decide_claims(claims, results)]


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
def test_decisions(tmp_path, left, direction, margin, expected):
    assert decided(tmp_path, left, claim(direction, margin=margin)) == [expected]


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
        with tempfile.TemporaryDirectory() as folder:
            (found,) = decide_claims([claim(direction, margin=0.1)], make_results(Path(folder), results))
        assert found.tasks[0].margin == pytest.approx(10.2)
        assert found.decision == expected


def test_a_margin_of_shares_is_itself(tmp_path):
    half = {0: None, 1: None, 2: 100.0, 3: 100.0}
    results = {("ppo", "none"): half, ("geometric", "constant:500"): dict.fromkeys(range(4), 100.0)}
    (found,) = decide_claims([claim("same", measure="failed share", margin=0.1)], make_results(tmp_path, results))
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
def test_runs_without_spread_are_decided_by_their_number(tmp_path, runs, expected, number):
    """All runs fell: a sign test of five has p = 2 / 2^5 = 0.0625, of six 0.031."""
    fallen = dict.fromkeys(range(runs))
    claims = [claim(way, right=number, measure="failed share", margin=0.1) for way in ("greater", "less")]
    results = make_results(
        tmp_path, {("ppo", "none"): dict.fromkeys(range(runs), 1.0), ("geometric", "constant:500"): fallen}
    )
    found = decide_claims(claims, results)
    assert [each.decision for each in found] == expected
    assert "(no spread)" in claims_text([found])
    assert (f"more training runs that agree; {runs} cannot decide" in claims_text([found])) == (runs < 6)


def test_clocks_of_one_training_run_are_paired(tmp_path):
    together = {("geometric", "constant:100"): {s: 100.0 * s for s in range(5)}}
    together[("geometric", "constant:500")] = {s: 100.0 * s + 5.0 + 0.1 * s for s in range(5)}
    results = make_results(tmp_path, together)
    one = claim(right=Condition("geometric", "constant:100"))
    (found,) = decide_claims([one], results)
    assert found.decision == "supported"
    assert found.tasks[0].difference.method == "paired t"


def test_what_is_not_evaluated_decides_nothing(tmp_path):
    results = make_results(tmp_path, {("ppo", "none"): NONE})
    (found,) = decide_claims([claim()], results)
    assert (found.decision, found.after_holm) == ("not evaluated", "not evaluated")
    assert "nothing, one side is not measured" in claims_text([[found]])
    rows = (*results.grid.rows, Row(TASK, "geometric", ZOO, (0, 1), 1))
    (found,) = decide_claims([claim()], replace(results, grid=replace(results.grid, rows=rows)))
    assert "its evaluation" in claims_text([[found]])


def test_each_task_and_the_mean_over_tasks(tmp_path):
    results = make_results(tmp_path, {("ppo", "none"): NONE, ("geometric", "constant:500"): FAR})
    found = decide_claims([claim(tasks=(TASK, "Ant-v3")), claim(over="mean")], results)
    assert [each.decision for each in found] == ["undecided", "supported"]
    assert found[1].pooled.estimate == pytest.approx(100.0 / 102.0)


def test_a_mean_over_tasks_that_survives_holm_is_shown_as_decided(tmp_path):
    tasks = ("Swimmer-v3", "Ant-v3")
    results = make_results(tmp_path, {("ppo", "none"): NONE, ("geometric", "constant:500"): FAR}, tasks=tasks)
    found = decide_claims([claim(tasks=tasks, over="mean")], results)
    text = write_page(tmp_path / "README.md", results, [found], ()).read_text()
    assert "1 of 1 claim is decided as a whole. On single tasks or on average, 1 is decided, by Student's t. " in text
    assert "\n  - supported on average over the tasks: A sentence.\n" in text
    assert "undecided on" not in text
    assert "undecided again if the difference moved by" in claims_text([found])
    rows = claims_frame(found).select("task", "decision", "after Holm").rows()
    assert rows[-1] == ("mean of the tasks", "supported", "supported")
    assert [row[2] for row in rows[:-1]] == [None, None]


def test_a_decision_on_one_task_shows_both_sides_and_what_was_registered_together(tmp_path):
    tasks = ("Swimmer-v3", "Ant-v3")
    results = make_results(tmp_path, {("ppo", "none"): NONE, ("geometric", "constant:500"): FAR}, task=tasks[0])
    first = decide_claims([claim(tasks=tasks), claim(right=150.0, tasks=tasks[:1])], results)
    later = decide_claims([claim(tasks=tasks)], replace(results, test={}))
    text = write_page(tmp_path / "README.md", results, [first, later], ()).read_text()
    assert "Of 3 comparisons that were registered first, 2 are evaluated. " in text
    assert "Of 2 registered later and corrected by themselves, none are. " in text
    assert "Return: 202.0 (geometric time-to-go, always 500 steps to go), 102.0 (discounted PPO).\n" in text
    assert "Return: 202.0 (geometric time-to-go, always 500 steps to go), threshold 150.\n" in text
    # 5 runs against 5: 3 * 2 / 252 = 0.024. One side: 3 * 2 / 32 = 0.19.
    assert "could pass this correction in 1 of the comparisons, and does in 1:" in text
    assert "Of 3 comparisons that were registered first" in claims_text([first, later])


def test_the_clock_plays_no_part_in_measures_of_training(tmp_path):
    results = make_results(tmp_path, {("ppo", "none"): NONE})
    shown = claims_text([decide_claims([claim(measure="action dependence"), claim(measure="return")], results)])
    assert shown.count("Left: `geometric`. ") == 1
    assert shown.count("Left: `geometric` under always 500 steps to go. ") == 1


def test_a_mean_over_tasks_without_spread_is_not_decided_by_an_interval_of_width_0(tmp_path):
    same = {("ppo", "none"): dict.fromkeys(range(3), 0.0), ("geometric", "constant:500"): dict.fromkeys(range(3), 1.0)}
    results = make_results(tmp_path, same, tasks=("Swimmer-v3", "Ant-v3"))
    (found,) = decide_claims([claim(tasks=("Swimmer-v3", "Ant-v3"), over="mean", measure="gain")], results)
    assert (found.pooled.error, found.decision) == (0.0, "undecided")


def test_holm_counts_all_comparisons(tmp_path):
    """One comparison with p = 0.03 stands alone, and falls among many."""
    left = {0: 106.0, 1: 105.0, 2: 110.0, 3: 102.0, 4: 113.0}
    right = {0: 100.0, 1: 103.0, 2: 99.0, 3: 98.0, 4: 104.0}
    results = make_results(tmp_path, {("ppo", "none"): right, ("geometric", "constant:500"): left})
    (alone,) = decide_claims([claim()], results)
    assert 0.02 < alone.tasks[0].p < 0.05
    assert alone.after_holm == "supported"
    among = decide_claims([claim()] * 5, results)
    assert {each.decision for each in among} == {"supported"}
    assert {each.after_holm for each in among} == {"undecided"}


@pytest.mark.parametrize(("effect", "runs"), [(1.0, 10), (0.5, 34)])
def test_the_number_of_runs_for_a_power_of_80_percent(effect, runs):
    """Of a paired t test, by G*Power 3.1: effect sizes of 1 and 0.5, two-sided, 5 %."""
    four = effect + math.sqrt(3.0) / 2.0 * np.array([-1.0, -1.0, 1.0, 1.0])  # standard deviation 1
    assert runs_needed(compare_with(four, 0.0), effect) == runs


def test_the_number_of_runs_on_each_of_two_sides():
    """Welch's t of equal spreads, by G*Power 3.1: an effect size of 1 needs 17 on each side."""
    unit = math.sqrt(3.0) / 2.0 * np.array([-1.0, -1.0, 1.0, 1.0])
    assert runs_needed(compare_unpaired(unit + 1.0, unit), 1.0) == 17
    assert runs_needed(compare_unpaired(unit + 1.0, [*unit, *unit]), 1.0) in (15, 16, 17)  # eight spread less than four


def test_the_page_says_how_many_runs_would_decide(tmp_path):
    left = {0: 80.0, 1: 110.0, 2: 150.0, 3: 140.0, 4: 220.0}
    results = make_results(tmp_path / "some", {("ppo", "none"): NONE, ("geometric", "constant:500"): left})
    found = decide_claims([claim()], results)
    difference = found[0].tasks[0].difference
    runs = runs_needed(difference, abs(difference.estimate))
    assert f"about {runs} training runs, if" in claims_text([found])
    assert claims_frame(found)["decision"].to_list() == ["undecided"]


def test_the_page_does_not_estimate_very_many_runs(tmp_path):
    results = make_results(tmp_path, {("ppo", "none"): NONE, ("geometric", "constant:500"): WIDE})
    assert "more than 50 training runs" in claims_text([decide_claims([claim()], results)])


def test_the_chosen_clock_is_that_of_the_validation_start_states(tmp_path):
    clocks = [("geometric", f"constant:{steps}") for steps in (100, 200)]
    test = {clocks[0]: {0: 1.0, 1: 9.0, 2: 9.0}, clocks[1]: {0: 5.0, 1: 4.0, 2: 4.0}}
    validation = {clocks[0]: dict.fromkeys(range(3), 0.0), clocks[1]: dict.fromkeys(range(3), 1.0)}
    results = make_results(tmp_path, test, validation)
    assert results.values(TASK, Condition("geometric", "chosen")) == {0: 5.0, 1: 4.0, 2: 4.0}
    assert results.values(TASK, Condition("geometric", "best")) == {0: 1.0, 1: 9.0, 2: 9.0}


def test_the_chosen_clock_is_used_for_each_run(tmp_path):
    clocks = {
        ("geometric", "constant:100"): {0: 1.0, 1: 9.0, 2: 9.0},
        ("geometric", "constant:200"): {0: 5.0, 1: 4.0, 2: 4.0},
    }
    results = make_results(tmp_path, clocks)
    # Without seed 0 constant:100 is best (9 against 4); without seed 1 or 2 too (5 against 4.5).
    assert results.values(TASK, Condition("geometric", "chosen")) == {0: 1.0, 1: 9.0, 2: 9.0}
    assert results.values(TASK, Condition("geometric", "best")) == {0: 1.0, 1: 9.0, 2: 9.0}


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"direction": "greter"}, "did you mean 'greater'"),
        ({"measure": "returns"}, "did you mean 'return'"),
        ({"tasks": ()}, "tasks is empty"),
        ({"margin": -1.0}, "margin is -1.0"),
        ({"over": "any"}, "over is 'any', known are each, mean"),
    ],
)
def test_a_claim_that_makes_no_sense_is_refused(parts, message):
    with pytest.raises(StudyError, match=message):
        claim(**parts)


def test_an_unknown_rule_is_refused():
    with pytest.raises(StudyError, match="did you mean 'chosen'"):
        Condition("geometric", "choosen")
