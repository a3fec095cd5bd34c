"""The claims of the cure on invented data: measures by hand, tests with known answers, the order of the decisions."""

from itertools import product

import numpy as np
import polars as pl
import pytest

from studies.cure.claims import CLAIMS, claims_table, measure_runs, sign_flip_p
from studies.cure.grid import ANT_SEEDS, ARMS, BASE, BASE_SEEDS
from studies.disturbance.grid import TASKS

NAMES = {BASE: TASKS, **{arm.name: arm.tasks for arm in ARMS}}


def episode(**changes):
    """A robot that earns 1 a step when idle and 3 as published, over 100 steps."""
    usual = {"task": "Hopper-v3", "arm": BASE, "train_seed": 13, "condition": "standard-1", "outcome": "holds"}
    numbers = {"test_horizon": 100, "end_step": 100, "failed_step": 100, "return": 300.0}
    rates = {"idle_rate": 1.0, "published_rate": 3.0, "training_rate": 2.0}
    return {**usual, **numbers, **rates, **changes}


@pytest.mark.parametrize(
    ("changes", "work", "score"),
    [
        ({}, 1.0, 1.0),
        ({"return": 100.0}, 0.0, 0.0),  # it stands
        ({"end_step": 50, "return": 150.0, "failed_step": 50}, 0.5, 0.25),  # it falls half-way at full speed
        ({"end_step": 50, "return": 50.0, "failed_step": 50}, 0.0, -0.25),  # it stands and falls half-way
        ({"return": 200.0}, 0.5, 0.5),  # half as fast
        ({"return": 0.0}, -0.5, -0.5),  # not floored
    ],
)
def test_work_pays_neither_for_standing_nor_for_slowness(changes, work, score):
    found = measure_runs(pl.DataFrame([episode(**changes)])).row(0, named=True)
    assert (found["work"], found["score"], found["speed"]) == pytest.approx((work, score, 0.5))


def test_a_run_is_the_mean_of_its_episodes():
    rows = [
        episode(eval_seed=1),
        episode(eval_seed=2, outcome="falls", end_step=50, failed_step=50, **{"return": 50.0}),
    ]
    found = measure_runs(pl.DataFrame(rows)).row(0, named=True)
    assert (found["work"], found["holding share"], found["steps between failures"]) == (0.5, 0.5, 150.0)


def test_random_signs_of_three_pairs_are_the_exact_share():
    rng = np.random.default_rng(0)
    pairs = [(np.array([3.0, 4.0, 5.0]), np.array([1.0, 1.0, 1.0]))]
    assert sign_flip_p(pairs, rng, 50_000) == pytest.approx(1 / 8, abs=0.01)
    assert sign_flip_p(pairs, rng, 50_000, two_sided=True) == pytest.approx(2 / 8, abs=0.01)
    assert sign_flip_p(2 * pairs, rng, 50_000) == pytest.approx(1 / 64, abs=0.005)
    worse = [(pairs[0][1], pairs[0][0])]
    assert sign_flip_p(worse, rng, 50_000) == 1.0


def test_pairs_decide_where_runs_differ_more_than_the_sides():
    """A constant gain over base runs of very different quality is found; shuffled pairs hide it."""
    rng = np.random.default_rng(0)
    base = np.arange(7.0)
    pairs = [(base + 0.1, base)]
    shuffled = [(base[::-1] + 0.1, base)]
    assert sign_flip_p(pairs, rng, 20_000) < 0.01
    assert sign_flip_p(shuffled, rng, 20_000) > 0.2


def invented(work, missing=()):
    """Runs of every kind whose episodes have about this work, by arm; 0.5 where none is named."""
    rng = np.random.default_rng(1)
    rows = []
    for name, tasks in NAMES.items():
        quiet = name.endswith("quiet")
        seeds = ANT_SEEDS if quiet else BASE_SEEDS
        for task, seed in product(tasks, seeds):
            if (name, task, seed) in missing:
                continue
            share = work.get(name, 0.5) + rng.normal(0.0, 0.01)
            condition = "calm" if quiet else "standard-1"
            gained = episode(task=task, arm=name, train_seed=seed, condition=condition)
            rows.append({**gained, "return": 100.0 + 200.0 * share})
    return pl.DataFrame(rows)


def decisions(frame):
    return claims_table(frame).drop_nulls("decision").sort("claim")["decision"].to_list()


LONG, NOISE, CALM = "continued-long-noise", "continued-noise", "continued-long"
ALL_TRUE = {
    **{BASE: 0.2, LONG: 0.9, NOISE: 0.5, CALM: 0.6, "geometric-noise-1.3M": 0.7},
    **{"geometric-quiet": 0.6, "ppo-quiet": 0.4, "continued-geometric-noise": 0.8},
}


def test_what_is_larger_in_every_run_is_supported_in_order():
    table = claims_table(invented(ALL_TRUE))
    assert decisions(invented(ALL_TRUE)) == ["supported"] * 6
    effects = table.drop_nulls("decision").sort("claim")["effect"].to_list()
    assert effects == pytest.approx([0.7, 0.4, 0.3, 0.2, 0.2, -0.1], abs=0.02)


def test_the_first_claim_that_is_not_significant_ends_the_decisions():
    equal = {**ALL_TRUE, CALM: 0.9}
    assert decisions(invented(equal)) == [
        "supported",
        "supported",
        "not shown",
        "not tested",
        "not tested",
        "not tested",
    ]


def test_the_wrong_direction_is_not_supported():
    assert decisions(invented({**ALL_TRUE, BASE: 0.95}))[0] == "not shown"


def test_missing_runs_decide_nothing():
    missing = [(NOISE, "Walker2d-v3", 15)]
    assert decisions(invented(ALL_TRUE, missing))[:3] == ["supported", "runs are missing", "not tested"]


def test_every_claim_names_kinds_of_runs_that_the_grid_trains():
    for claim in CLAIMS:
        for side in (claim.left, claim.right):
            assert set(claim.tasks) <= set(NAMES[side])
