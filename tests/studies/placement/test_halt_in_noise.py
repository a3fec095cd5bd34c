"""Halting under exploration noise: which apples are counted, and what is noisy."""

from types import SimpleNamespace

import numpy as np
import pytest

from perdure.home.evaluate.policies import shipped_seeds
from perdure.home.sim.simulator import ARM, GRASP, GRIP, RELEASE
from perdure.policy import load_policy
from studies.placement.measurements import BASE, HALT_STEPS, LANES, PARTS, _Halting, outcomes


@pytest.fixture(scope="module")
def policy():
    return load_policy(shipped_seeds("set_table", "place")[0])


def test_without_noise_a_robot_that_halts_keeps_its_apples_and_one_that_goes_on_does_not(policy):
    one = 1  # rounded up to all lanes
    halts, goes_on = (outcomes(policy, one, way, "none", "base and arm") for way in (True, False))
    assert halts["stayed"] == halts.total() > LANES / 2
    assert goes_on["stayed"] < goes_on.total() / 2
    assert goes_on.total() == halts.total()  # until the release both do the same


@pytest.mark.verify
def test_strong_noise_moves_apples_of_a_robot_that_halts(policy):
    noisy = outcomes(policy, LANES + 1, True, "exp(-1)", "base and arm")
    assert noisy["stayed"] < noisy.total() / 2
    assert LANES < noisy.total() <= 2 * LANES


class Scripted:
    """A policy whose action opens the hand at every step; the object is in its goal in the lanes of `in_goal`."""

    def __init__(self, halts, noise, in_goal):
        action = np.full(GRIP + 1, 0.25)
        action[GRIP] = -0.5
        policy = SimpleNamespace(
            task=SimpleNamespace(observation_size=2), act=lambda observations, _: np.tile(action, (LANES, 1))
        )
        state = SimpleNamespace(holds_target=np.ones(LANES, bool), object_to_goal=np.where(in_goal, 0.0, 1.0))
        self.action = action
        self.halting = _Halting(
            policy, SimpleNamespace(state=state, progress=SimpleNamespace(elapsed=np.zeros(LANES))), halts, noise
        )

    def act(self, steps=1):
        return np.array([self.halting.act(np.zeros((LANES, 3))) for _ in range(steps)])


NOWHERE, EVERYWHERE = np.zeros(LANES, bool), np.ones(LANES, bool)


@pytest.mark.parametrize("halts", [False, True])
@pytest.mark.parametrize(
    ("parts", "noisy", "exact"), [("base", BASE, ARM), ("arm", ARM, BASE)], ids=["base alone", "arm alone"]
)
def test_noise_of_one_part_leaves_the_other_and_the_hand(halts, parts, noisy, exact):
    scripted = Scripted(halts, PARTS[parts], NOWHERE)
    actions = scripted.act(200)
    assert (actions[..., exact] == scripted.action[exact]).all()
    assert (actions[..., GRIP] == scripted.action[GRIP]).all()
    drawn = actions[..., noisy] - scripted.action[noisy]
    assert drawn.std(axis=(0, 1)) == pytest.approx(1.0, abs=0.05)


def test_the_robot_halts_where_the_release_is_commanded_in_the_goal():
    in_goal = np.arange(LANES) < 3
    scripted = Scripted(True, (0.0, 0.0), in_goal)
    actions = scripted.act(HALT_STEPS + 5)
    assert (actions[:, ~in_goal] == scripted.action).all()
    assert (actions[:, in_goal, :GRIP] == 0.0).all()
    assert (actions[:HALT_STEPS, in_goal, GRIP] == GRASP).all()
    assert (actions[HALT_STEPS:, in_goal, GRIP] == RELEASE).all()
    assert scripted.halting.asked.tolist() == in_goal.tolist()


def test_a_robot_that_goes_on_does_what_the_policy_says():
    scripted = Scripted(False, (0.0, 0.0), EVERYWHERE)
    assert (scripted.act(HALT_STEPS + 5) == scripted.action).all()
    assert scripted.halting.asked.all()
