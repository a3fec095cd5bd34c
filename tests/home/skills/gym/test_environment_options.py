"""Options of skill environments: those that make no sense are refused before anything is built."""

from typing import Any

import gymnasium
import numpy as np
import pytest
from lanes import make

from perdure.errors import PerdureError
from perdure.home.skills.gym import SkillEnvOptions, env_id


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"skill": "juggle"}, "juggle"),
        ({"skill": "open_drawer", "task": "tidy_house"}, "never uses"),
        ({"targets": (5,)}, r"\(5,\)"),
        ({"targets": ()}, r"\(\)"),
        ({"skill": "pick", "delta": 30}, "delta"),
        ({"delta": 0}, "delta"),
        ({"skill": "pick", "gentle": True}, "gentle is an option of place"),
        ({"actions": "feet"}, "actions must be one of 'joints', 'hand', not 'feet'"),
        ({"rolling": "ice"}, "ice"),
        ({"split": "test"}, "test"),
        ({"task": "lay_table"}, "lay_table"),
        ({"physics_hz": 100}, "100"),
        ({"episodes": 0}, "episodes"),
        ({"episodes": "5"}, "episodes must be a whole number .*, not '5'"),
        ({"episodes": 2.5}, "episodes must be a whole number .*, not 2.5"),
        ({"delta": 1.5}, "delta must be a whole number .*, not 1.5"),
        ({"delta": True}, "delta must be a whole number .*, not True"),
        ({"targets": True}, "targets.* must be int, not bool"),
        ({"targets": 1.5}, "targets.* must be int, not float"),
        ({"clutter": "no"}, "clutter must be true or false, not 'no'"),
        ({"training": "off"}, "training must be true or false, not 'off'"),
        ({"task": ["set_table"]}, "task must be one of .*'set_table'"),
        ({"skill": None}, "skill must be text"),
        ({"physics_hz": 120.0}, "physics_hz must be a whole number from 120 .*, not 120.0"),
        ({"physics_hz": 90}, "physics_hz must be a whole number from 120 .*, not 90"),
    ],
)
def test_options_that_make_no_sense_are_refused(options, word):
    with pytest.raises(PerdureError, match=word):
        SkillEnvOptions(**options)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"threads": 0}, "threads"),
        ({"threads": "2"}, "threads"),
        ({"max_episode_steps": 10.5}, "max_episode_steps"),
        ({"lanes": 0}, "num_envs"),
    ],
)
def test_settings_of_the_vector_of_a_wrong_type_are_refused(options, word):
    with pytest.raises(PerdureError, match=word):
        make("place", "tidy_house", **options)


def test_numpys_numbers_count_as_whole_numbers():
    env = make("place", "set_table", lanes=np.int64(2), delta=np.int32(3), targets=np.array([1]))
    assert (env.options.delta, env.options.chosen_targets) == (3, (1,))


def test_an_unknown_option_is_named():
    with pytest.raises(PerdureError, match="color"):
        make("place", "tidy_house", color="red")


ONE: dict[str, Any] = {"split": "val", "episodes": 1}
"""Training episodes are generated where there are none yet, which takes most of a minute."""


def test_a_step_limit_in_which_the_object_cannot_stay_is_refused():
    with pytest.raises(PerdureError, match="max_episode_steps=450"):
        gymnasium.make_vec(env_id("place"), num_envs=2, delta=250, **ONE)  # the default limit is 200 steps
    gymnasium.make_vec(env_id("place"), num_envs=2, delta=250, max_episode_steps=450, **ONE).close()


def test_an_id_refuses_another_skill():
    with pytest.raises(PerdureError, match="perdure/HomePick-v0"):
        gymnasium.make(env_id("place"), split="val", episodes=1, skill="pick")


def test_an_id_makes_a_vector_of_its_own_skill_alone():
    with pytest.raises(PerdureError, match="perdure/HomePlace-v0 has the skill place, not pick"):
        gymnasium.make_vec(env_id("place"), num_envs=2, skill="pick")


def test_a_single_environment_may_be_given_threads():
    gymnasium.make(env_id("place"), split="val", episodes=1, threads=2).close()
