"""Home environments behind the vector contract, by name."""

import numpy as np
import pytest

from perdure.envs import list_tasks, make_world
from perdure.errors import PerdureError

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
