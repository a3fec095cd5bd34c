"""HorizonLimit against step patterns written out by hand."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stumbling import ACTION, Stumbling, flags

from perdure.errors import PerdureError
from perdure.horizon import Fixed, Infinite, Uniform
from perdure.wrappers import HorizonLimit

RUNS, FELL, CUT = (0, 0), (1, 0), (0, 1)


def limited(distribution, end, **world):
    env = HorizonLimit(Stumbling(**world), distribution, end)
    env.reset(seed=0)
    return env


def horizons_of(env, count, seed):
    env.reset(seed=seed)
    seen = [env.horizon]
    for _ in range(count - 1):
        env.reset()
        seen.append(env.horizon)
    return seen


def test_the_last_step_terminates():
    assert flags(limited(Fixed(3), "terminated"), 7) == [RUNS, RUNS, FELL, RUNS, RUNS, FELL, RUNS]


def test_the_last_step_truncates_if_told_so():
    assert flags(limited(Fixed(3), "truncated"), 7) == [RUNS, RUNS, CUT, RUNS, RUNS, CUT, RUNS]


def test_a_horizon_of_one_step_ends_every_step():
    assert flags(limited(Fixed(1), "truncated"), 3) == [CUT, CUT, CUT]


def test_a_fall_before_the_horizon_is_terminated_and_starts_the_count_anew():
    assert flags(limited(Fixed(3), "truncated", falls=[2]), 5) == [RUNS, FELL, RUNS, RUNS, CUT]


def test_a_fall_on_the_last_step_stays_terminated_and_nothing_else():
    assert flags(limited(Fixed(3), "truncated", falls=[3]), 6) == [RUNS, RUNS, FELL, RUNS, RUNS, CUT]
    assert flags(limited(Fixed(3), "terminated", falls=[3]), 3) == [RUNS, RUNS, FELL]


def test_what_the_world_cuts_itself_stays_truncated():
    assert flags(limited(Fixed(3), "terminated", cuts=[2]), 5) == [RUNS, CUT, RUNS, RUNS, FELL]


def test_reaching_the_horizon_outranks_a_cut_of_the_world_on_the_same_step():
    assert flags(limited(Fixed(3), "terminated", cuts=[3]), 3) == [RUNS, RUNS, FELL]


def test_an_infinite_horizon_leaves_the_world_alone():
    assert flags(limited(Infinite(), "terminated", falls=[50]), 60).index(FELL) == 49


def test_the_count_is_public():
    env = limited(Fixed(3), "terminated")
    assert (env.elapsed, env.horizon) == (0, 3)
    env.step(ACTION)
    assert (env.elapsed, env.horizon) == (1, 3)


def test_nothing_but_the_flags_is_changed():
    bare, env = Stumbling(), limited(Fixed(2), "terminated")
    bare.reset(seed=7), env.reset(seed=7)
    for _ in range(2):
        observation, reward, _, _, info = env.step(ACTION)
        bare_observation, bare_reward, _, _, bare_info = bare.step(ACTION)
        assert np.array_equal(observation, bare_observation)
        assert (reward, info) == (bare_reward, bare_info)


def test_episode_lengths_are_the_drawn_horizons():
    env = limited(Uniform(2, 5), "truncated")
    lengths, drawn = [], []
    for _ in range(40):
        env.reset()
        drawn.append(env.horizon)
        lengths.append(1 + next(step for step in range(9) if env.step(ACTION)[3]))
    assert lengths == drawn
    assert set(lengths) == {2, 3, 4, 5}


def test_the_same_seed_draws_the_same_horizons_and_another_seed_others():
    one, two = limited(Uniform(200, 1000), "terminated"), limited(Uniform(200, 1000), "terminated")
    assert horizons_of(one, 10, seed=3) == horizons_of(two, 10, seed=3) == horizons_of(one, 10, seed=3)
    assert horizons_of(one, 10, seed=4) != horizons_of(two, 10, seed=3)


def test_resets_without_a_seed_go_on_drawing():
    assert len(set(horizons_of(limited(Uniform(1, 100_000), "terminated"), 20, seed=3))) == 20


def test_horizons_say_nothing_about_start_states():
    distribution, starts, horizons, shared = Uniform(200, 1000), [], [], []
    env = HorizonLimit(Stumbling(), distribution, "terminated")
    for seed in range(300):
        starts.append(env.reset(seed=seed)[0][0])
        horizons.append(env.horizon)
        shared.append(distribution.from_uniform(gymnasium.utils.seeding.np_random(seed)[0].random()))
    assert abs(np.corrcoef(starts, horizons)[0, 1]) < 0.2
    # What would happen if the horizons came from the environment's own stream:
    assert np.corrcoef(starts, shared)[0, 1] > 0.99


def test_start_states_are_those_without_the_wrapper():
    bare, env = Stumbling(), HorizonLimit(Stumbling(), Uniform(2, 9), "terminated")
    for seed in (5, None, None):
        assert np.array_equal(bare.reset(seed=seed)[0], env.reset(seed=seed)[0])


@pytest.mark.filterwarnings("ignore:.*WARN:UserWarning")
def test_gymnasium_approves():
    check_env(HorizonLimit(Stumbling(), Uniform(3, 8), "terminated"), skip_render_check=True)


def test_gymnasium_can_rebuild_it_from_its_spec():
    env = HorizonLimit(gymnasium.make("Pendulum-v1", max_episode_steps=-1), Uniform(200, 1000), "truncated")
    again = gymnasium.make(env.spec)
    assert isinstance(again, HorizonLimit)
    assert (again.distribution, again.end) == (env.distribution, env.end)


def test_a_shorter_limit_of_the_environments_own_is_refused():
    short = gymnasium.make("Pendulum-v1")  # 200 steps
    with pytest.raises(PerdureError, match=r"200.*1000"):
        HorizonLimit(short, Uniform(200, 1000), "terminated")
    with pytest.raises(PerdureError, match="inf"):
        HorizonLimit(short, Infinite(), "truncated")
    assert HorizonLimit(short, Fixed(200), "terminated").distribution == Fixed(200)


def test_a_step_before_the_first_reset_is_refused():
    with pytest.raises(PerdureError, match="reset"):
        HorizonLimit(Stumbling(), Fixed(3), "terminated").step(ACTION)


@pytest.mark.parametrize(
    ("distribution", "end", "sentence"),
    [
        (1000, "terminated", "needs a HorizonDistribution, such as .*, got 1000"),
        (Fixed(3), "done", "end must be one of terminated, truncated, got 'done'"),
    ],
)
def test_wrong_settings_are_refused(distribution, end, sentence):
    with pytest.raises(PerdureError, match=sentence):
        HorizonLimit(Stumbling(), distribution, end)
