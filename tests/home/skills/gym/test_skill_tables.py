"""The page about skills agrees with the code."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from lanes import make

from perdure.home.skills import get_skill, learned_skills

TOOL = Path(__file__).parents[4] / "tools" / "skill_tables.py"
pytestmark = pytest.mark.skipif(not TOOL.exists(), reason="the tool is no part of an installed package")


@pytest.fixture(scope="module")
def tool():
    spec = importlib.util.spec_from_file_location("skill_tables", TOOL)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("skill", learned_skills())
def test_the_page_names_every_reward_term_and_the_last_number_and_action(tool, skill):
    env = make(skill, "set_table", episodes=1)
    observations, _ = env.reset(seed=0)
    info = env.step(np.zeros(env.action_space.shape))[-1]
    assert set(tool.reward_texts(env.skill)) == {name for name in info["reward_terms"] if not name.startswith("_")}
    text = tool.page()
    assert f"{observations.shape[1] - 1} `{env.skill.elements[-1].name}`|" in text
    actions = env.single_action_space.shape[0]
    assert f"|{actions - 1} `{'grip' if actions == 10 else 'turn'}`|" in text


@pytest.mark.parametrize("skill", learned_skills())
def test_every_failure_condition_has_a_text_and_the_other_way_round(skill):
    env = make(skill, "set_table", episodes=1)
    env.reset(seed=0)
    assert set(env.skill.failure_conditions(env.state, env.progress)) == set(get_skill(skill).failures)
