"""Disturbances against closed forms and against the same world without them."""

import gymnasium
import numpy as np
import pytest

from perdure.envs import make_world
from perdure.envs.disturbances import SIMULATED, Disturbance, DisturbedWorld, disturbed_task, parse_disturbance
from perdure.envs.gymnasium import GymnasiumWorld
from perdure.errors import PerdureError


class Echo(gymnasium.Env):
    """Observes the action that acted."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float64)
    action_space = gymnasium.spaces.Box(np.array([-1.0, 0.0]), np.array([1.0, 4.0]), dtype=np.float64)

    def reset(self, *, seed=None, options=None):
        return np.zeros(2), {}

    def step(self, action):
        return np.array(action, np.float64), 0.0, False, False, {}


def echoed(*texts, seeds=(5,), steps=4000, action=(0.0, 2.0), std=None):
    """The observations of every step, shape (steps, lanes, 2)."""
    world = GymnasiumWorld([Echo] * len(seeds), list(seeds))
    disturbed = DisturbedWorld(world, [parse_disturbance(text) for text in texts], seeds, std)
    disturbed.reset()
    return np.stack([disturbed.step(np.tile(action, (len(seeds), 1))).observations for _ in range(steps)])


def test_action_noise_has_the_stated_spread_and_never_leaves_the_box():
    acted = echoed("action_noise:0.1")[:, 0]
    assert acted.mean(axis=0) == pytest.approx([0.0, 2.0], abs=0.02)
    assert acted.std(axis=0) == pytest.approx([0.1, 0.2], rel=0.05)  # half ranges 1 and 2
    assert abs(np.corrcoef(acted[:-1, 0], acted[1:, 0])[0, 1]) < 0.05
    wild = echoed("action_noise:3", steps=500)[:, 0]
    assert wild.min(axis=0) == pytest.approx([-1.0, 0.0])
    assert wild.max(axis=0) == pytest.approx([1.0, 4.0])


def test_observation_noise_is_in_units_of_the_spread_in_training():
    seen = echoed("observation_noise:0.5", std=np.array([[2.0, 0.1]]))[:, 0]
    assert seen.std(axis=0) == pytest.approx([1.0, 0.05], rel=0.05)
    with pytest.raises(PerdureError, match="spread of the observations"):
        echoed("observation_noise:0.5")


def test_a_delayed_action_acts_that_many_steps_later():
    world = GymnasiumWorld([Echo], [0])
    disturbed = DisturbedWorld(world, [parse_disturbance("action_delay:3")], [0])
    for _ in range(2):  # the queue of one episode does not reach the next
        disturbed.reset()
        acted = [disturbed.step(np.array([[0.1 * k, 1.0]])).observations[0, 0] for k in range(1, 8)]
        assert acted == pytest.approx([0.0, 0.0, 0.0, 0.1, 0.2, 0.3, 0.4])


def test_an_episode_meets_the_same_draws_alone_and_beside_others():
    alone, beside = echoed("action_noise:0.1", steps=600), echoed("action_noise:0.1", seeds=(1, 5), steps=600)
    assert (alone[:, 0] == beside[:, 1]).all()
    assert not np.isclose(beside[:, 0], beside[:, 1]).all()


def pushed(*texts, steps=202):
    """Observations of a Hopper that does nothing, without ends."""
    world = make_world("gymnasium:Hopper-v4", [3])
    disturbed = DisturbedWorld(world, [parse_disturbance(text) for text in texts], [3])
    disturbed.reset()
    (env,) = world.environments
    env.unwrapped.model.opt.gravity[:] = 0.0  # it floats, so that it lasts
    env.unwrapped._healthy_z_range = env.unwrapped._healthy_angle_range = (-np.inf, np.inf)
    speeds = []
    for _ in range(steps):
        disturbed.step(np.zeros((1, 3)))
        speeds.append(env.unwrapped.data.qvel.copy())
    world.close()
    return np.array(speeds)


def test_a_push_changes_the_speed_of_the_root_once_in_200_steps():
    calm, disturbed = pushed(), pushed("push:0.5")
    assert (calm[:200] == disturbed[:200]).all()
    change = disturbed[200, 0] - calm[200, 0]
    assert 1e-3 < abs(change) < 0.6
    assert (pushed("push:0") == calm).all()


def test_factors_change_the_model():
    calm, heavy = make_world("gymnasium:Hopper-v4", [0]), make_world("gymnasium:Hopper-v4", [0])
    DisturbedWorld(heavy, [parse_disturbance(text) for text in ("mass:1.2", "friction:0.5", "strength:0.9")], [0])
    before, after = (world.environments[0].unwrapped.model for world in (calm, heavy))
    assert after.body_mass == pytest.approx(before.body_mass * [1, 1.2, 1, 1, 1])
    assert after.geom_friction[:, 0] == pytest.approx(0.5 * before.geom_friction[:, 0])
    assert after.actuator_gear == pytest.approx(0.9 * before.actuator_gear)
    assert after.body_subtreemass[1] == pytest.approx(after.body_mass[1:].sum())


@pytest.mark.parametrize("task", ["Hopper-v3", "Walker2d-v3", "HalfCheetah-v3", "Swimmer-v3"])
def test_gymnasiums_copy_makes_the_same_step_as_envpool(task):
    """From the state that EnvPool's first observation shows; positions along the track do not matter."""
    pool, copy = make_world(task, [7]), make_world(SIMULATED[task], [7])
    shown = pool.reset()[0]
    copy.reset()
    env = copy.environments[0].unwrapped
    hidden = env.model.nq + env.model.nv - len(shown)
    env.set_state(np.concatenate([np.zeros(hidden), shown[: env.model.nq - hidden]]), shown[env.model.nq - hidden :])
    action = 0.125 * np.arange(pool.spec.action_size)[None]  # exact in single precision
    ours, theirs = pool.step(action), copy.step(action)
    assert theirs.observations == pytest.approx(ours.observations, abs=1e-9)
    assert theirs.rewards == pytest.approx(ours.rewards, abs=1e-5)  # EnvPool's rewards are float32
    pool.close()
    copy.close()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("pushes:1", "push"),
        ("push", "name:level"),
        ("push:-1", "0 or more"),
        ("action_delay:0.5", "whole control steps"),
    ],
)
def test_what_is_no_disturbance_is_refused(text, words):
    with pytest.raises(PerdureError, match=words):
        parse_disturbance(text)


def test_a_world_that_cannot_be_pushed_says_which_can():
    push = [parse_disturbance("push:0.5")]
    assert disturbed_task("Hopper-v3", push) == "gymnasium:Hopper-v4"
    assert disturbed_task("Hopper-v3", [parse_disturbance("action_noise:0.1")]) == "Hopper-v3"
    with pytest.raises(PerdureError, match="Hopper-v3"):
        disturbed_task("Ant-v3", push)
    world = make_world("Hopper-v3", [0])
    with pytest.raises(PerdureError, match="gymnasium:ID"):
        DisturbedWorld(world, push, [0])
    world.close()
    with pytest.raises(PerdureError, match="twice"):
        DisturbedWorld(make_world("gymnasium:Hopper-v4", [0]), 2 * push, [0])


def test_labels_are_read_again():
    for text in ("action_noise:0.1", "action_delay:2", "push:0.5", "mass:1.2"):
        found = parse_disturbance(text)
        assert isinstance(found, Disturbance)
        assert found.label == text
