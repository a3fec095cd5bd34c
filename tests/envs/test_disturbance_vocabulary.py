"""What holds for every kind of disturbance, those of other packages included."""

import numpy as np
import pytest

from perdure.disturbances import Disturbance, Effect, applied_disturbances, labels, parse_disturbance
from perdure.envs import make_world, task_spec
from perdure.envs.disturbances import DisturbedWorld
from perdure.errors import PerdureError
from perdure.evaluate import Extrapolation

KINDS = Effect.kinds()
every_kind = pytest.mark.parametrize("name", KINDS)


def observed(*texts, seeds=(5,), steps=230):
    """Observations of Hoppers that act at random, without ends, shape (steps, lanes, 11)."""
    world = make_world("gymnasium:Hopper-v4", list(seeds))
    spread = np.tile(np.linspace(0.1, 1.0, 11), (len(seeds), 1))
    disturbed = DisturbedWorld(world, [parse_disturbance(text) for text in texts], seeds, spread)
    for env in world.environments:
        env.unwrapped._healthy_z_range = env.unwrapped._healthy_angle_range = (-np.inf, np.inf)
        env.unwrapped._healthy_state_range = (-np.inf, np.inf)
    rng, found = np.random.default_rng(0), [disturbed.reset()]
    for _ in range(steps):
        found.append(disturbed.step(np.tile(rng.uniform(-1.5, 1.5, 3), (len(seeds), 1))).observations)
    world.close()
    return np.array(found)


@pytest.fixture(scope="module")
def calm():
    return observed()


@every_kind
def test_it_says_what_it_does(name):
    kind = KINDS[name]
    assert kind.words
    assert kind.unit
    assert kind.example != kind.neutral


@every_kind
def test_a_level_out_of_bounds_is_refused(name):
    kind = KINDS[name]
    for level in (kind.least - 1.0, float("nan"), float("inf"), kind.below):
        with pytest.raises(PerdureError, match=name):
            parse_disturbance(f"{name}:{level}")


@pytest.mark.parametrize(
    "text", ["push:0.5", "mass:1.05", "action_delay:2", "push:0.1234567", "push:0.30000000000000004", "slope:1234567"]
)
def test_a_label_reads_back_as_exactly_the_disturbance(text):
    asked = parse_disturbance(text)
    assert asked.label == text
    assert parse_disturbance(f"{text}@5+7").label == f"{text}@5+7"
    assert parse_disturbance(asked.label) == asked


def test_levels_that_differ_in_the_seventh_digit_are_two_conditions():
    asked = Extrapolation(disturb=("push:0.1234567,0.1234568",))
    conditions = asked.conditions(task_spec("gymnasium:Hopper-v4"), lambda _: make_world("gymnasium:Hopper-v4", [5]))
    assert [each.label for each in conditions] == ["push:0.1234567", "push:0.1234568"]


def test_what_a_world_could_not_do_is_left_out_of_what_episodes_met():
    met = applied_disturbances("standard-1", "friction, mass, push, strength")
    assert labels(met) == "action_noise:0.02 observation_noise:0.01"
    assert applied_disturbances("mass:2 push:0.5@7", "") == (Disturbance("mass", 2.0), Disturbance("push", 0.5, 7))
    assert applied_disturbances("none", "standard-1, because Reach has a goal") == ()


@every_kind
def test_its_neutral_level_changes_nothing(name, calm):
    assert np.array_equal(observed(f"{name}:{KINDS[name].neutral:g}"), calm)


@every_kind
def test_an_episode_meets_the_same_alone_and_beside_others(name, calm):
    text = f"{name}:{KINDS[name].example:g}"
    alone = observed(text)[:, 0]
    assert np.array_equal(alone, observed(text, seeds=(9, 5))[:, 1])
    assert not np.array_equal(alone, calm[:, 0])
