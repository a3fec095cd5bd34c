"""Sentences are decided as they must be on tables of known answer."""

import math
from dataclasses import replace

import pytest
from known_results import make_results
from scipy import stats

from perdure.stats import compare_unpaired
from studies.horizon.claims import Claim, Condition, decide, effect, holm, p_value, read_claims
from studies.horizon.grid import GRIDS
from studies.horizon.results import MEASURED

CLAIM = Claim("A sentence.", "3", "geometric constant:500", "ppo", "greater", "return", ("Hopper-v3",))
PPO, FAR = {0: 100.0, 1: 101.0, 2: 105.0}, {0: 200.0, 1: 201.0, 2: 202.0}


def values_of(left, right=PPO, **parts):
    return make_results({("ppo", "none"): right, ("geometric", "constant:500"): left}, **parts).values


@pytest.mark.parametrize(
    ("direction", "low", "high", "expected"),
    [
        ("greater", 0.1, 0.2, "supported"),
        ("greater", -0.2, -0.1, "contradicted"),
        ("greater", -0.1, 0.2, "undecided"),
        ("less", -0.2, -0.1, "supported"),
        ("less", 0.1, 0.2, "contradicted"),
        ("not less", -0.05, 0.2, "supported"),
        ("not less", -0.3, -0.2, "contradicted"),
        ("not less", -0.3, 0.2, "undecided"),
        ("greater", math.nan, math.nan, "undecided"),
    ],
)
def test_decisions(direction, low, high, expected):
    assert decide(replace(CLAIM, direction=direction), low, high) == expected


def test_the_effect_on_one_task_is_welch_s():
    found, known = effect(CLAIM, values_of(FAR)), compare_unpaired(list(FAR.values()), list(PPO.values()))
    assert (found.estimate, found.lower, found.upper) == pytest.approx((99.0, known.lower, known.upper))


@pytest.mark.parametrize(("direction", "shift"), [("greater", 0.0), ("less", 0.0), ("not less", 0.1)])
def test_the_p_value_is_that_of_welch_s_test_of_the_bound(direction, shift):
    claim = replace(CLAIM, direction=direction)
    left = {seed: value - 100.0 for seed, value in FAR.items()}
    found = effect(claim, values_of(left))
    known = stats.ttest_ind([value + shift for value in left.values()], list(PPO.values()), equal_var=False)
    assert p_value(claim, found) == pytest.approx(known.pvalue)


def test_no_p_value_without_an_error():
    assert math.isnan(p_value(CLAIM, compare_unpaired([1.0], [2.0])))


def test_holm_s_correction_is_that_of_r():
    """p.adjust(c(0.01, 0.04, 0.03, 0.005, 0.9), "holm")"""
    assert holm([0.01, 0.04, 0.03, 0.005, 0.9]) == pytest.approx([0.04, 0.09, 0.09, 0.025, 0.9])


def test_clocks_of_the_same_runs_are_paired():
    results = make_results(
        {("geometric", "constant:0"): {0: 2.0, 1: 12.0, 2: 23.0}, ("geometric", "constant:500"): PPO}
    )
    claim = replace(CLAIM, left="geometric constant:0", right="geometric constant:500")
    found = effect(claim, results.values)
    differences = (98.0, 89.0, 82.0)
    mean = sum(differences) / 3
    spread = (sum((each - mean) ** 2 for each in differences) / 2 / 3) ** 0.5
    assert (found.estimate, found.upper - found.estimate) == pytest.approx((-mean, 4.302653 * spread))


def test_the_mean_over_tasks_beside_a_number():
    claim = replace(CLAIM, right=151.0, tasks=("Hopper-v3", "Ant-v3"))
    found = effect(claim, values_of(FAR, tasks=("Hopper-v3", "Ant-v3")))
    assert (found.estimate, found.upper - found.estimate) == pytest.approx((50.0, 2.776445 / 6**0.5))


def test_a_sentence_with_a_task_that_is_missing_has_no_effect():
    assert effect(replace(CLAIM, tasks=("Hopper-v3", "Ant-v3")), values_of(FAR)) is None
    assert effect(CLAIM, values_of({0: 1.0})) is None


def test_every_sentence_names_rows_of_the_grid_and_measures_that_exist():
    claims, grid = read_claims(), GRIDS["thesis"]
    assert len(claims) <= 15
    for claim in claims:
        assert claim.measure in (*MEASURED, "value variance")
        decide(claim, 0.0, 0.0)
        for side in (claim.left, claim.right):
            if isinstance(side, str):
                assert all(grid.row(task, Condition.parse(side).method) for task in claim.tasks), claim.sentence
