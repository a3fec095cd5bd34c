"""The page about skills says what the code does."""

from pathlib import Path

import numpy as np
import pytest
from lanes import make

from perdure.home.skills import SKILLS, get_skill
from perdure.home.skills.gym.tables import FAILURES, page, reward_terms, skill_section
from perdure.home.skills.starts import STARTS

PAGE = Path(__file__).parents[4] / "docs" / "home" / "skills.md"


@pytest.mark.skipif(not PAGE.exists(), reason="the page is no part of an installed package")
def test_the_page_is_the_one_the_code_writes():
    assert PAGE.read_text(encoding="utf-8") == page()


def test_the_page_says_when_each_failure_happens_and_of_no_other():
    assert set(FAILURES) == {name for skill in STARTS for name in SKILLS[skill].failures[1:]}


@pytest.mark.parametrize("skill", STARTS)
def test_the_page_names_every_term_of_the_reward_and_every_number_that_is_seen(skill):
    env = make(skill, "set_table", episodes=1)
    observations, _ = env.reset(seed=0)
    info = env.step(np.zeros(env.action_space.shape))[-1]
    assert set(reward_terms(env.skill)) == {name for name in info["reward_terms"] if not name.startswith("_")}
    text = skill_section(get_skill(skill))
    assert f"| {observations.shape[1] - 1} `{env.skill.elements[-1].name}` |" in text
    actions = env.single_action_space.shape[0]
    assert f"| {actions - 1} `{'grip' if actions == 10 else 'turn'}` |" in text
