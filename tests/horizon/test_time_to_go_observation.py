"""TimeToGoObservation: the expected phi, step by step."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stumbling import ACTION, Stumbling

from perdure.errors import PerdureError
from perdure.horizon import Constant, Countdown, Fixed, Geometric, Linear, Periodic, Uniform
from perdure.wrappers import HorizonLimit, TimeToGoObservation

COIN = Geometric(1, low=0.5, high=0.5)  # phi = 2^-(time-to-go)


def told(env, count, dict=False):
    """What the agent is told at the reset and after each of `count` steps."""
    observations = [env.reset(seed=0)[0], *(env.step(ACTION)[0] for _ in range(count))]
    return [observation["time_to_go"].tolist() if dict else observation[2:].tolist() for observation in observations]


def limited(embedding, horizon=4, **options):
    return TimeToGoObservation(HorizonLimit(Stumbling(), Fixed(horizon), "terminated"), embedding, **options)


def test_linear_runs_from_1_to_0_over_an_episode():
    assert told(limited(Linear()), 4) == [[1.0], [0.75], [0.5], [0.25], [0.0]]


def test_geometric_runs_up_to_1():
    assert told(limited(Geometric(2, 0.5, 1.0)), 4) == [[1 / 16, 1], [1 / 8, 1], [1 / 4, 1], [1 / 2, 1], [1, 1]]


def test_the_next_episode_starts_afresh():
    env = limited(Linear())
    assert told(env, 2) == told(env, 2) == [[1.0], [0.75], [0.5]]


def test_phi_follows_the_drawn_horizon():
    limit = HorizonLimit(Stumbling(), Uniform(2, 50), "terminated")
    env = TimeToGoObservation(limit, COIN)
    for seed in range(20):
        observation, _ = env.reset(seed=seed)
        assert -np.log2(observation[2]) == limit.horizon


@pytest.mark.parametrize(
    ("clock", "to_go"),
    [
        (Constant(4), [4, 4, 4, 4, 4, 4]),
        (Constant(0), [0, 0, 0, 0, 0, 0]),
        (Periodic(3), [3, 2, 1, 3, 2, 1]),
        (Countdown(4), [4, 3, 2, 1, 0, 0]),
    ],
    ids=lambda value: getattr(value, "label", ""),
)
def test_in_deployment_the_clock_is_told(clock, to_go):
    phi = told(TimeToGoObservation(Stumbling(), COIN, clock=clock), 5)
    assert [-np.log2(value) for [value] in phi] == to_go


def test_a_clock_is_told_instead_of_the_horizon_beneath():
    env = limited(COIN, clock=Constant(3))
    assert told(env, 3) == [[1 / 8]] * 4
    assert env.step(ACTION)[2]  # and the episode still ends on step 4


def test_the_rest_of_the_observation_is_untouched():
    bare, env = Stumbling(), limited(Linear())
    assert np.array_equal(env.reset(seed=3)[0][:2], bare.reset(seed=3)[0])
    assert np.array_equal(env.step(ACTION)[0][:2], bare.step(ACTION)[0])


def test_as_a_dictionary_phi_stands_beside_the_observation():
    env = limited(Linear(), dict=True)
    assert told(env, 2, dict=True) == [[1.0], [0.75], [0.5]]
    observation, _ = env.reset(seed=3)
    assert np.array_equal(observation["observation"], Stumbling().reset(seed=3)[0])
    assert env.observation_space["observation"] == Stumbling().observation_space
    assert env.observation_space.contains(observation)


def test_dictionary_observations_can_only_stand_beside_phi():
    limit = HorizonLimit(Stumbling(as_dict=True), Fixed(4), "terminated")
    with pytest.raises(PerdureError, match="dict=True"):
        TimeToGoObservation(limit, Linear())
    env = TimeToGoObservation(limit, Linear(), dict=True)
    assert env.observation_space.contains(env.reset(seed=0)[0])


def test_a_float32_observation_stays_float32():
    limit = HorizonLimit(gymnasium.make("Pendulum-v1"), Fixed(200), "truncated")
    observation, _ = TimeToGoObservation(limit, Geometric(5)).reset(seed=0)
    assert observation.dtype == np.float32
    assert observation.shape == (8,)


def test_whole_numbers_cannot_carry_phi():
    frozen_lake = gymnasium.make("FrozenLake-v1", max_episode_steps=-1)
    with pytest.raises(PerdureError, match=r"Discrete\(16\)"):
        TimeToGoObservation(frozen_lake, Linear(), clock=Constant(5))


def test_without_horizon_or_clock_nothing_can_be_told():
    with pytest.raises(PerdureError, match="HorizonLimit"):
        TimeToGoObservation(Stumbling(), Linear())
    with pytest.raises(PerdureError, match="HorizonLimit"):
        TimeToGoObservation(gymnasium.wrappers.TimeLimit(Stumbling(), 4), Linear())


def test_other_wrappers_may_stand_in_between():
    limit = HorizonLimit(Stumbling(), Fixed(4), "terminated")
    between = gymnasium.wrappers.TransformReward(limit, lambda reward: 2 * reward)
    assert told(TimeToGoObservation(between, Linear()), 2) == [[1.0], [0.75], [0.5]]


class Twice(gymnasium.Wrapper):
    """Repeats every action once."""

    def step(self, action):
        self.env.step(action)
        return self.env.step(action)


def test_the_time_is_that_of_the_limit_whatever_is_skipped_above_it():
    limit = HorizonLimit(Stumbling(), Fixed(4), "terminated")
    assert told(TimeToGoObservation(Twice(limit), Linear()), 2) == [[1.0], [0.5], [0.0]]


@pytest.mark.filterwarnings("ignore:.*WARN:UserWarning")
@pytest.mark.parametrize("as_dict", [False, True])
@pytest.mark.parametrize("clock", [None, Periodic(3)])
def test_gymnasium_approves(as_dict, clock):
    check_env(limited(Geometric(3), clock=clock, dict=as_dict), skip_render_check=True)


def test_gymnasium_can_rebuild_it_from_its_spec():
    pendulum = gymnasium.make("Pendulum-v1", max_episode_steps=-1)
    env = TimeToGoObservation(HorizonLimit(pendulum, Uniform(2, 9), "truncated"), Geometric(4), dict=True)
    again = gymnasium.make(env.spec)
    assert again.observation_space == env.observation_space
