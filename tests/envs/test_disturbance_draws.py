"""What a disturbance draws: for whom, how often, and what else in the model stays as it was."""

from types import SimpleNamespace

import gymnasium
import mujoco
import numpy as np
import pytest

from perdure.disturbances import STANDARDS, Disturber, parse_disturbance
from perdure.disturbances.kinds import horizontal_velocities
from perdure.envs.disturbances import DisturbedWorld
from perdure.envs.gymnasium import GymnasiumWorld
from perdure.wrappers import Disturb
from tests.envs.test_disturbances import BOX, Echo, change, echoed


def test_noise_does_not_repeat_with_its_blocks():
    acted = echoed("action_noise:0.1", steps=600)[:, 0]
    assert not np.isclose(acted[:256], acted[256:512]).any()


def test_noise_of_actions_and_of_observations_are_other_draws():
    """Echo observes the action that acted one step before its observation's own noise."""
    seen = echoed("action_noise:0.1", "observation_noise:0.1", std=np.ones((1, 2)))[:, 0, 0]
    assert abs(np.corrcoef(seen[:-1], seen[1:])[0, 1]) < 0.1


def test_a_command_is_clipped_before_its_noise_and_before_its_lag():
    noisy = echoed("action_noise:0.1", action=(5.0, 2.0))[:, 0, 0]
    assert (noisy < 1.0).mean() == pytest.approx(0.5, abs=0.05)
    assert echoed("lag:0.5", steps=3, action=(3.0, 2.0))[:, 0, 0] == pytest.approx([0.5, 0.75, 0.875])


def test_a_lag_begins_anew_with_every_episode():
    world = DisturbedWorld(GymnasiumWorld([Echo], [0]), [parse_disturbance("lag:0.5")], [0])
    for _ in range(2):
        world.reset()
        assert world.step(np.array([[1.0, 0.0]])).observations[0, 0] == 0.5


def test_a_push_moves_what_slides_sideways():
    hopper = gymnasium.make("Hopper-v4").unwrapped.model
    assert horizontal_velocities(hopper).tolist() == [0]  # its second slide is vertical
    assert horizontal_velocities(mujoco.MjModel.from_xml_string(BOX.format(""))).tolist() == [0, 1]


def test_pushes_come_from_every_side():
    model = mujoco.MjModel.from_xml_string(BOX.format(""))
    data = mujoco.MjData(model)
    env = SimpleNamespace(unwrapped=SimpleNamespace(model=model, data=data))
    pusher, found = Disturber("box", [parse_disturbance("push:0.5")], range(400), None, None, [env] * 400), []
    for lane in np.arange(400):
        data.qvel[:] = 0.0
        pusher.act(np.zeros((1, 0)), np.array([lane]), np.array([200]))
        found.append(data.qvel[:2].copy())
    assert np.mean(found) == pytest.approx(0.0, abs=0.05)
    assert np.abs(found).max() == pytest.approx(0.5, abs=0.02)


def test_mass_brings_inertia_and_friction_is_sliding_friction_of_pairs_too():
    floor = (
        '<geom name="floor" type="plane" size="1 1 1"/></worldbody><contact><pair geom1="box" geom2="floor"/></contact>'
    )
    xml = BOX.replace("<geom ", '<geom name="box" ').replace("</worldbody>", floor).format("")
    usual, changed = (mujoco.MjModel.from_xml_string(xml) for _ in range(2))
    change(changed, "mass:1.2", "friction:0.5")
    np.testing.assert_allclose(changed.body_inertia[1], 1.2 * usual.body_inertia[1])
    np.testing.assert_allclose(changed.pair_friction[:, :2], 0.5 * usual.pair_friction[:, :2])
    np.testing.assert_allclose(changed.geom_friction[:, 1:], usual.geom_friction[:, 1:])


def test_an_episode_keeps_its_own_spread_when_the_one_before_it_has_ended():
    spreads = np.array([[100.0] * 2, [1.0] * 2])
    noise = [parse_disturbance("observation_noise:0.1")]
    world = DisturbedWorld(GymnasiumWorld([Echo] * 2, [0, 1]), noise, [0, 1], spreads)
    world.reset()
    world.abandon(np.array([0]))
    seen = [world.step(np.zeros((1, 2)), np.array([1])).observations[0, 0] for _ in range(500)]
    assert np.std(seen) == pytest.approx(0.1, rel=0.15)


def test_a_wrapped_environment_gets_no_impossible_action():
    env = Disturb(Echo(), ["action_noise:3"], 0)
    env.reset()
    assert max(abs(env.step(np.zeros(2))[0][0]) for _ in range(50)) <= 1.0


def test_a_standard_always_means_the_same():
    assert STANDARDS["standard-1"] == (
        *("action_noise:0.02", "observation_noise:0.01", "push:0.1"),
        *("mass:1.05", "friction:0.95", "strength:0.95"),
    )


def test_what_a_new_kind_makes_of_an_observation_reaches_the_policy_everywhere(monkeypatch):
    """It may return another array, and needs no spread of the observations."""
    monkeypatch.setattr(Disturber, "observe", lambda self, observations, lanes, elapsed: observations + 7.0)
    world = DisturbedWorld(GymnasiumWorld([Echo], [0]), [parse_disturbance("lag:0")], [0])
    assert world.reset()[0, 0] == 7.0
    assert world.step(np.array([[1.0, 0.0]])).observations[0, 0] == 8.0
    env = Disturb(Echo(), ["lag:0"], 0)
    assert env.reset()[0][0] == 7.0
    assert env.step(np.array([1.0, 0.0]))[0][0] == 8.0
