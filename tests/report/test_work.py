"""Work of episodes, worked out by hand."""

import math

import numpy as np
import polars as pl
import pytest

from perdure.report.work import episode_work, with_work


@pytest.mark.parametrize(
    ("earned", "end", "idle", "reference", "work"),
    [
        (300.0, 100, 1.0, 3.0, 1.0),  # as the reference, to the end
        (100.0, 100, 1.0, 3.0, 0.0),  # as an idle robot
        (150.0, 50, 1.0, 3.0, 0.5),  # as the reference until it falls at half time
        (50.0, 100, 1.0, 3.0, -0.25),  # worse than idle
        (-600.0, 100, -10.0, -2.0, 0.5),  # rewards that are costs
        (60.0, 60, 1.0, 1.0, 0.6),  # a step pays the same to anybody: survival
        (60.0, 60, 1.0, 0.9, math.nan),
        (60.0, 60, 1.0, math.nan, math.nan),
    ],
)
def test_work_of_an_episode_of_100_steps(earned, end, idle, reference, work):
    assert float(episode_work(earned, end, 100, idle, reference)) == pytest.approx(work, nan_ok=True)


def episodes(*rows):
    """Rows of episodes of 100 steps that earn 2 in training and nothing when idle."""
    same = {"task": "Robot", "policy": "ppo", "train_seed": 0, "clock": "none", "settling": 20, "test_horizon": 100}
    same |= {"end_step": 100, "idle_rate": 0.0, "training_rate": 2.0, "published_rate": 8.0, "policy_state": "worked"}
    return pl.DataFrame([same | {"disturbance": "none", "outcome": "holds"} | row for row in rows])


def curve(start, rate):
    """A robot that earns `start` a step for 20 steps, then `rate`."""
    return np.array([10, 20, 60, 100]), np.array(
        [10.0 * start, 20.0 * start] + [20 * start + rate * k for k in (40, 80)]
    )


def test_calm_episodes_that_hold_give_the_calm_rate_after_settling():
    facts = episodes({}, {}, {"outcome": "decays"}, {"disturbance": "push:1"}, {"clock": "constant(5)"})
    found = with_work(facts, [curve(0.0, 3.0), curve(0.0, 5.0), curve(0.0, 0.5), curve(1.0, 1.0), curve(2.0, 2.0)])
    assert found["calm_rate"].to_list() == [4.0] * 4 + [2.0]
    assert found["work_vs_calm"].to_list() == pytest.approx([0.6, 1.0, 0.1, 0.25, 1.0])
    assert found["work_vs_published"].to_list() == pytest.approx([0.3, 0.5, 0.05, 0.125, 0.25])


def test_without_a_calm_episode_that_holds_training_gives_the_rate():
    facts = episodes({"outcome": "falls", "end_step": 50}, {"disturbance": "push:1"})
    assert with_work(facts, [curve(1.0, 9.0)] * 2)["calm_rate"].to_list() == [2.0, 2.0]


def test_a_policy_that_never_worked_has_no_work_against_itself():
    found = with_work(episodes({"policy_state": "never worked"}), [curve(1.0, 1.0)])
    assert math.isnan(found["work_vs_calm"][0])
    assert found["work_vs_published"][0] == pytest.approx(0.125)
