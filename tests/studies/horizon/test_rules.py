"""Successive halving finds a C that is known to hold."""

from tiny_study import pendulum_policy

from perdure.evaluate import EpisodeSpec, evaluate_episodes
from perdure.horizon import Constant, Fixed, Geometric, HorizonProtocol
from studies.horizon.rollouts import choose_by_halving

PROTOCOL = HorizonProtocol(Geometric(2), Fixed(1000), "terminated", 1.0, 1.0)
CANDIDATES = [Constant(float(c)) for c in range(100, 1001, 100)]


def test_halving_ends_with_a_clock_that_keeps_the_pole_up():
    """Pushed aside by 10 * 0.99^C, the pole falls under small C at once; from some C on it never falls."""
    policy = pendulum_policy(PROTOCOL, Constant(500.0), push=(-10.0,))
    records = evaluate_episodes([policy], [EpisodeSpec(0, clock, 0, steps=1000) for clock in CANDIDATES])
    holding = {clock for clock, end in zip(CANDIDATES, records.end_step, strict=True) if end == 1000}
    assert 0 < len(holding) < len(CANDIDATES)
    found, steps = choose_by_halving(policy, CANDIDATES, 1000)
    assert found in holding
    assert 0 < steps < 2 * (10 * 500 + 5 * 1000 + 3 * 1000 + 2 * 1000)  # falls cost less


def test_halving_takes_the_first_of_equals():
    policy = pendulum_policy(PROTOCOL, Constant(500.0))
    assert choose_by_halving(policy, CANDIDATES, 20)[0] == CANDIDATES[0]
