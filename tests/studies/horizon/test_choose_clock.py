"""Cross-validation picks the clock worked out by hand; the optimistic choice is biased exactly where there is noise."""

import numpy as np
import polars as pl
import pytest
from known_results import make_results

from studies.horizon.claims import Condition
from studies.horizon.results import best_clock, cross_validated, values_under


def runs(returns):
    """A table of runs: {C: [return of seed 0, 1, ...]}."""
    rows = [
        {
            "clock": f"constant:{c}",
            "clock_kind": "constant",
            "clock_steps": float(c),
            "train_seed": seed,
            "return": float(value),
        }
        for c, values in returns.items()
        for seed, value in enumerate(values)
    ]
    return pl.DataFrame(rows)


RULES = ("chosen", "chosen periodic")
BY_HAND = {100: [9, 0, 0], 200: [2, 2, 2], 300: [0, 3, 3]}


def test_each_run_is_left_out_of_its_own_choice():
    # Without seed 0 the means are 0, 2, 3; without seed 1: 4.5, 2, 1.5; without seed 2 the same.
    assert cross_validated(runs(BY_HAND)) == {0: "constant:300", 1: "constant:100", 2: "constant:100"}


def test_the_optimistic_choice_is_the_highest_mean():
    assert best_clock(runs(BY_HAND)) == "constant:100"


def choices(validation, test):
    """The returns of the cross-validated and of the optimistic choice on test start states."""
    return values_under(test, cross_validated(validation)), values_under(
        test, dict.fromkeys(test["train_seed"], best_clock(test))
    )


def test_returns_are_those_of_the_test_start_states():
    test = runs({100: [1, 2, 3], 200: [4, 5, 6], 300: [7, 8, 9]})
    chosen, best = choices(runs(BY_HAND), test)
    assert chosen == {0: 7.0, 1: 2.0, 2: 3.0}
    assert best == {0: 7.0, 1: 8.0, 2: 9.0}


def test_of_equals_the_least_c_is_taken():
    assert cross_validated(runs({300: [1, 1], 100: [1, 1]})) == {0: "constant:100", 1: "constant:100"}


def test_a_single_run_chooses_for_itself():
    assert cross_validated(runs({100: [1], 200: [2]})) == {0: "constant:200"}


def test_other_kinds_of_clocks_take_no_part():
    sweep = {("geometric", f"constant:{c}"): dict(enumerate(each)) for c, each in BY_HAND.items()}
    results = make_results({**sweep, ("geometric", "periodic:500"): dict.fromkeys(range(3), 99.0)})
    chosen = {kind: set(results.clocks("Hopper-v3", Condition("geometric", kind)).values()) for kind in RULES}
    assert chosen == {"chosen": {"constant:100", "constant:300"}, "chosen periodic": {"periodic:500"}}


def test_no_clock_to_choose_among_is_no_choice():
    results = make_results({("geometric", "countdown"): {0: 1.0, 1: 2.0}})
    assert [results.clocks("Hopper-v3", Condition("geometric", kind)) for kind in (*RULES, "best")] == [{}] * 3


def bias(noise, repeats=200, clocks=11, seeds=5):
    """Mean of (optimistic - cross-validated) where every C is equally good but for noise."""
    rng = np.random.default_rng(0)

    def table():
        return runs({100 * k: 10.0 + noise * rng.normal(size=seeds) for k in range(clocks)})

    found = [[np.mean(list(choice.values())) for choice in choices(table(), table())] for _ in range(repeats)]
    return float(np.mean([best - chosen for chosen, best in found]))


def test_the_optimistic_choice_flatters_by_the_expected_maximum_of_the_noise():
    expected_maximum = 1.586  # of 11 standard normal numbers (Harter, 1961)
    assert bias(1.0) == pytest.approx(expected_maximum / np.sqrt(5), rel=0.15)


def test_without_noise_there_is_no_bias():
    assert bias(0.0, repeats=3) == 0.0


def test_where_a_run_is_not_evaluated_under_its_clock_the_others_are_no_sample():
    assert values_under(runs({100: [1, 2]}), {0: "constant:100", 7: "constant:100"}) == {}


def test_a_run_whose_measure_has_no_value_is_left_out():
    table = runs({100: [1, 2]}).with_columns(pl.when(pl.col("train_seed") == 1).then("return").alias("return"))
    assert values_under(table, {0: "constant:100", 1: "constant:100"}) == {1: 2.0}
