"""Home environments behind the vector contract, by name."""

from pathlib import Path

import gymnasium
import numpy as np
import pytest

from perdure.disturbances import STANDARD, parse_disturbances
from perdure.envs import list_tasks, make_world, task_spec
from perdure.envs.disturbances import DisturbedWorld, disturbed_task
from perdure.errors import PerdureError
from perdure.evaluate import Extrapolation
from perdure.wrappers import Disturb

NAME = "perdure/HomePlace-v0,split=val,episodes=2"


def test_every_skill_is_listed_with_its_limit():
    listed = {each.name: each.default_horizon for each in list_tasks("Home")}
    assert len(listed) == 7
    assert listed["perdure/HomeNavigate-v0"] == 500
    assert listed["perdure/HomePlace-v0"] == 200


def test_a_lane_of_the_world_runs_as_it_runs_alone_to_the_last_bit():
    many, one = make_world(NAME, [3, 4, 5]), make_world(NAME, [4])
    np.testing.assert_array_equal(many.reset()[1:2], one.reset())
    rng = np.random.default_rng(0)
    for _ in range(30):
        actions = rng.uniform(-1.0, 1.0, (3, 10))
        step, alone = many.step(actions), one.step(actions[1:2])
        np.testing.assert_array_equal(step.observations[1:2], alone.observations)
        assert (step.rewards[1], step.ended[1]) == (alone.rewards[0], alone.ended[0])
        ended = step.ended if step.elapsed.max() < 20 else np.ones(3, np.bool_)  # new episodes after 20 steps at most
        if ended.any():
            many.reset(np.flatnonzero(ended))
        if ended[1]:
            one.reset()


def test_options_stand_behind_the_name():
    world = make_world("perdure/HomePlace-v0,task=set_table,delta=30,split=val,episodes=1", [0])
    assert world.spec.observation_size == 53
    assert world.spec.name == "perdure/HomePlace-v0,task=set_table,delta=30,split=val,episodes=1"


def test_a_world_without_a_horizon_is_not_cut_at_the_skills_limit():
    world = make_world("perdure/HomePick-v0,split=val,episodes=1", [0])
    world.reset()
    for _ in range(210):
        assert not world.step(np.zeros((1, 10))).truncated[0]


def test_a_world_tells_that_it_diverged():
    world = make_world(NAME, [0, 1])
    world.reset()
    world._env.world.simulator(1).qvel[:] = np.nan
    step = world.step(np.zeros((2, 10)))
    assert (step.diverged.tolist(), step.truncated.tolist()) == ([False, True], [False, True])


@pytest.mark.parametrize(
    ("name", "error"),
    [("perdure/HomeCook-v0", PerdureError), (f"{NAME},delta", PerdureError), (f"{NAME},color=red", PerdureError)],
)
def test_names_that_mean_nothing_are_refused(name, error):
    with pytest.raises(error):
        make_world(name, [0])


class TestDisturbances:
    """Noise and delay act on any world; the home's model changes from episode to episode, so its physics stays."""

    ACTS = ("action_noise:0.1", "observation_noise:0.1", "action_delay:1")

    def test_of_the_standard_what_is_not_applied_is_named(self):
        spec = task_spec(NAME)
        asked = Extrapolation((Path("p"),))
        calm, disturbed = asked.conditions(spec, lambda found: make_world(disturbed_task(NAME, found), [0]))
        assert [each.name for each in disturbed.disturbances] == ["action_noise", "observation_noise"]
        assert {*disturbed.not_applied.split(", ")} == {"push", "mass", "friction", "strength"}
        assert (calm.not_applied, disturbed.label) == ("", STANDARD)

    @pytest.mark.parametrize("kind", ["push:0.1", "mass:1.1", "friction:0.9", "strength:0.9", "slope:3"])
    def test_what_needs_the_model_is_refused_by_name(self, kind):
        found = parse_disturbances([kind])
        with pytest.raises(PerdureError, match=kind.split(":")[0]):
            DisturbedWorld(make_world(disturbed_task(NAME, found), [0]), found, [0])
        env = gymnasium.make("perdure/HomePlace-v0", split="val", episodes=2)
        with pytest.raises(PerdureError, match=kind.split(":")[0]):
            Disturb(env, [kind])

    def test_noise_and_delay_act_alike_in_a_world_and_in_the_wrapper(self):
        name, options = "perdure/HomeNavigate-v0", {"split": "val", "episodes": 1}
        world, calm = (make_world(f"{name},split=val,episodes=1", [3]) for _ in range(2))
        std = np.full(world.spec.observation_size, 0.01)
        disturbed = DisturbedWorld(world, parse_disturbances(self.ACTS), [3], std[None])
        env = Disturb(gymnasium.make(name, max_episode_steps=-1, **options), self.ACTS, 3, std)
        assert (env.reset(seed=3)[0] == disturbed.reset()[0]).all()
        calm.reset()
        rng = np.random.default_rng(0)
        for _ in range(5):
            action = rng.uniform(-1.0, 1.0, (1, world.spec.action_size))
            step, undisturbed = disturbed.step(action), calm.step(action)
            assert (env.step(action[0])[0] == step.observations[0]).all()
        assert not np.allclose(step.observations, undisturbed.observations, atol=0.003)
