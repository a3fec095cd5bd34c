"""Rules without a sweep find the C that is known to be best."""

from dataclasses import replace

import pytest
from tiny_study import GRID, pendulum_policy, write_training

from perdure.extrapolate import LaneSpec, evaluate_lanes
from perdure.horizon import Constant, Fixed, Geometric, HorizonProtocol
from perdure.runs import StoreError
from perdure.studies.horizon.choose_clock_bandit import choose_by_halving
from perdure.studies.horizon.choose_clock_value import choose_by_value
from perdure.studies.horizon.rules import rule_steps
from perdure.studies.study import RunOptions

PROTOCOL = HorizonProtocol(Geometric(2), Fixed(1000), "terminated", 1.0, 1.0)
CANDIDATES = [Constant(float(c)) for c in range(100, 1001, 100)]


def test_the_critic_s_highest_value_for_each_step_is_taken():
    """V(C) = 1 - 2 * 0.99^C whatever the state: V(C) / C is highest at 200 (0.0037; 0.0027 at 100, 0.0030 at 300)."""
    policy = pendulum_policy(PROTOCOL, Constant(500.0), value=(-2.0, 1.0))
    found = choose_by_value(policy, CANDIDATES)
    assert found.clock == Constant(200.0)
    assert found.scores[Constant(200.0)] == pytest.approx((1 - 2 * 0.99**200) / 200, rel=1e-4)
    assert found.lane_steps == 4000


def test_halving_ends_with_a_clock_that_keeps_the_pole_up():
    """Pushed aside by 10 * 0.99^C, the pole falls under small C at once; from some C on it never falls."""
    policy = pendulum_policy(PROTOCOL, Constant(500.0), push=(-10.0,))
    records = evaluate_lanes([policy], [LaneSpec(0, clock, 0) for clock in CANDIDATES], 1000)
    holding = {clock for clock, end in zip(CANDIDATES, records.end_step, strict=True) if end == 1000}
    assert 0 < len(holding) < len(CANDIDATES)
    found = choose_by_halving(policy, CANDIDATES, 1000)
    assert found.clock in holding
    assert 0 < found.lane_steps < 2 * (10 * 500 + 5 * 1000 + 3 * 1000 + 2 * 1000)  # falls cost less


def test_halving_takes_the_first_of_equals():
    policy = pendulum_policy(PROTOCOL, Constant(500.0))
    assert choose_by_halving(policy, CANDIDATES, 20).clock == CANDIDATES[0]


def test_choices_made_with_other_settings_are_not_read(tmp_path):
    write_training(tmp_path)
    (step,) = rule_steps(GRID, tmp_path)
    step.run(RunOptions(on="here"))
    assert set(step.folders()) == {0, 1}
    with pytest.raises(StoreError, match="candidates"):
        replace(step, settings={**step.settings, "candidates": [100.0]}).folders()
