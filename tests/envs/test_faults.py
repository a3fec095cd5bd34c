"""Disturbances with an onset and a duration, against closed forms."""

import gymnasium
import mujoco
import numpy as np
import pytest

from perdure.disturbances import Disturbance, Disturber, parse_disturbance
from perdure.envs import make_world
from perdure.envs.disturbances import DisturbedWorld
from perdure.envs.gymnasium import GymnasiumWorld
from perdure.errors import PerdureError
from perdure.evaluate import Extrapolation
from perdure.learn import method_config
from perdure.learn.run import TrainRun
from perdure.wrappers import Disturb
from tests.envs.test_disturbances import Echo, echoed


def test_a_text_is_read_once_into_fields():
    assert parse_disturbance("strength:0.5") == Disturbance("strength", 0.5, 0, None)
    assert parse_disturbance("strength:0.5@2000") == Disturbance("strength", 0.5, 2000, None)
    assert parse_disturbance("strength:0.5@2000+500") == Disturbance("strength", 0.5, 2000, 500)
    assert parse_disturbance("strength:0.5@0") == parse_disturbance("strength:0.5")
    for text in ("strength:0.5", "strength:0.5@2000", "strength:0.5@2000+500", "strength:0.5@0+500"):
        assert parse_disturbance(text).label == text


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("push:1@", "ONSET"),
        ("push:1@-3", "ONSET"),
        ("push:1@soon", "ONSET"),
        ("push:1@10+", "ONSET"),
        ("push:1@10+0", "at least 1"),
        ("time_step:0.5@10", "physics steps to a control step"),
    ],
)
def test_a_time_that_means_nothing_is_refused(text, words):
    with pytest.raises(PerdureError, match=words):
        parse_disturbance(text)


def test_a_fault_that_would_never_act_is_refused():
    asked = Extrapolation(("Hopper-v3/ppo",), 100, disturb=("action_noise:0.1@100",))
    world = make_world("Hopper-v3", [0])
    with pytest.raises(PerdureError, match="never act"):
        asked.conditions(world.spec, lambda disturbances: world)
    world.close()
    config = method_config("ppo", "Hopper-v3", 11)
    with pytest.raises(PerdureError, match="never act"):
        TrainRun("Hopper-v3", "ppo", config, disturb=("action_noise:0.1@1000",))
    assert TrainRun("Hopper-v3", "ppo", config, disturb=("push:1@999+1",)).disturb == ("push:1@999+1",)


def test_each_level_of_a_sweep_has_the_onset():
    asked = Extrapolation(("Hopper-v3/ppo",), 100, disturb=("action_noise:0.1,0.2@50+5",))
    world = make_world("Hopper-v3", [0])
    found = asked.conditions(world.spec, lambda disturbances: make_world("Hopper-v3", [0]))
    assert [each.label for each in found] == ["action_noise:0.1@50+5", "action_noise:0.2@50+5"]
    world.close()


def test_noise_is_that_of_the_whole_episode_inside_and_none_outside():
    whole, timed = echoed("action_noise:0.1", steps=600)[:, 0], echoed("action_noise:0.1@300+100", steps=600)[:, 0]
    assert np.array_equal(timed[300:400], whole[300:400])
    assert (timed[:300] == [0.0, 2.0]).all()
    assert (timed[400:] == [0.0, 2.0]).all()
    assert (timed[300:400] != [0.0, 2.0]).all()


def test_observation_noise_has_an_end():
    """Echo observes the action of the step before."""
    seen = echoed("observation_noise:0.5@3+2", std=np.ones((1, 2)), steps=8)[:, 0, 0]
    assert (seen != 0.0).tolist() == [False, False, True, True, False, False, False, False]


def acted(text, commands):
    """The first component of the action that acts, step after step."""
    world = DisturbedWorld(GymnasiumWorld([Echo], [0]), [parse_disturbance(text)], [0])
    world.reset()
    return [world.step(np.array([[command, 1.0]])).observations[0, 0] for command in commands]


def test_a_delay_that_begins_repeats_the_last_commands():
    commands = np.arange(1, 9) / 10
    assert acted("action_delay:2@4+3", commands) == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.3, 0.4, 0.5, 0.8])


def test_a_lag_that_begins_starts_from_the_last_command():
    commands = [0.8, 0.8, 0.8, 0.0, 0.0, 0.0, 0.8]
    assert acted("lag:0.5@3+2", commands) == pytest.approx([0.8, 0.8, 0.8, 0.4, 0.2, 0.0, 0.8])


def test_a_fault_changes_the_model_of_its_lane_while_it_lasts():
    seeds = [0, 1]
    world = make_world("gymnasium:Hopper-v4", seeds)
    models = [env.unwrapped.model for env in world.environments]
    usual = gymnasium.make("Hopper-v4").unwrapped.model
    disturbed = DisturbedWorld(world, [parse_disturbance(text) for text in ("mass:1.5@2+3", "friction:0.5")], seeds)

    def factors():
        return [model.body_mass[1] / usual.body_mass[1] for model in models]

    def derived(model):
        return model.body_subtreemass, model.dof_invweight0, np.array([model.stat.meaninertia])

    disturbed.reset()
    found = []
    for step in range(8):
        if step == 4:  # the second lane begins anew, while its model is changed
            disturbed.reset(np.array([1]))
            found.append(factors())
        disturbed.step(np.zeros((2, 3)))
        found.append(factors())
        for model, factor in zip(models, found[-1], strict=True):
            assert model.body_subtreemass[1] == pytest.approx(model.body_mass[1:].sum())
            assert np.array_equal(model.geom_friction[:, 0], 0.5 * usual.geom_friction[:, 0])  # as long as it lasts
            same = [np.array_equal(*both) for both in zip(derived(model), derived(usual), strict=True)]
            assert all(same) == (factor == 1.0)
    first, second = np.array(found).T
    assert first == pytest.approx([1.0, 1.0, 1.5, 1.5, 1.5, 1.5, 1.0, 1.0, 1.0])
    assert second == pytest.approx([1.0, 1.0, 1.5, 1.5, 1.0, 1.0, 1.0, 1.5, 1.5])
    world.close()


def test_a_refused_reset_changes_nothing():
    world = DisturbedWorld(GymnasiumWorld([Echo], [5]), [parse_disturbance("action_noise:0.1@0+9")], [5])
    world.reset()
    with pytest.raises(PerdureError, match="lane"):
        world.reset(np.array([1]))
    seen = [world.step(np.array([[0.0, 2.0]])).observations[0] for _ in range(9)]
    assert np.array_equal(seen, echoed("action_noise:0.1", steps=9)[:, 0])


def test_faults_overlap():
    env = gymnasium.make("Hopper-v4")
    model, faults = env.unwrapped.model, [parse_disturbance(text) for text in ("slope:30@1+2", "strength:0.5@2+2")]
    disturber, lane = Disturber("Hopper", faults, [0], None, None, [env]), np.zeros(1, np.int64)
    before, found = model.actuator_gear[:, 0].copy(), []
    for step in range(5):
        disturber.act(np.zeros((1, 3)), lane, np.array([step]))
        found.append((round(model.opt.gravity[0], 3), model.actuator_gear[0, 0] / before[0]))
    assert found == [(0.0, 1.0), (-4.905, 1.0), (-4.905, 0.5), (0.0, 0.5), (0.0, 1.0)]


def test_a_push_with_an_onset_comes_there():
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><freejoint/><geom size=".1"/></body></worldbody></mujoco>'
    )
    env = gymnasium.Env()
    env.model, env.data = model, mujoco.MjData(model)
    disturber = Disturber("ball", [parse_disturbance("push:1@150+201")], [0], None, None, [env])
    pushed = []
    for step in range(600):
        before = env.data.qvel.copy()
        disturber.act(np.zeros((1, 0)), np.zeros(1, np.int64), np.array([step]))
        if not np.array_equal(before, env.data.qvel):
            pushed.append(step)
    assert pushed == [150, 350]


def test_the_wrapper_puts_the_model_back_before_a_reset():
    env = Disturb(gymnasium.make("Hopper-v4", max_episode_steps=-1), ["mass:2@1"], 0)
    model = env.unwrapped.model
    env.reset(seed=0)
    usual = model.body_mass[1]
    for _ in range(2):
        env.step(np.zeros(3))
    assert model.body_mass[1] == 2 * usual
    env.reset()
    assert model.body_mass[1] == usual
