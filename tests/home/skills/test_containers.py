"""Every container is whole: links, receptacles and skills that it names are there."""

import numpy as np
import pytest

from perdure.home.sim.apartments import make_apartment
from perdure.home.sim.pieces import CONTAINERS
from perdure.home.skills import SKILLS, get_skill
from perdure.home.tasks.episodes import load_episodes
from perdure.home.tasks.tasks import SKILL_CONTAINERS, SKILL_VERBS, TASKS, Verb


@pytest.fixture(params=CONTAINERS.values(), ids=CONTAINERS)
def container(request):
    return request.param


def test_its_joints_reach_the_positions_at_which_it_is_open_and_closed(container):
    for link in container.links:
        low, high = make_apartment(0, 0).articulation(link).limit
        assert low <= container.closed < container.opened <= high
        assert container.opened <= container.start_range[0] < container.start_range[1] <= high


def test_each_of_its_links_is_in_front_of_a_receptacle_of_every_apartment(container):
    for apartment in (make_apartment(0, 0), make_apartment(9, 3)):
        behind = {apartment.container(each.unique_name) for each in apartment.receptacles}
        assert set(container.links) <= behind


def test_its_skills_bring_it_from_closed_to_open_and_back(container):
    for name, wanted in ((container.open_skill, Verb.OPEN), (container.close_skill, Verb.CLOSE)):
        skill = get_skill(name)
        assert (SKILL_VERBS[name], SKILL_CONTAINERS[name]) == (wanted, container.name)
        goals = np.array([skill.wanted, skill.scripted_goal])
        assert skill.is_accepted(goals).all()
        reached = goals >= container.opened if wanted == Verb.OPEN else goals <= container.closed
        assert reached.all()


def test_every_skill_has_a_verb():
    assert set(SKILLS) == set(SKILL_VERBS)


@pytest.mark.parametrize("task", TASKS)
def test_an_episode_uses_the_link_that_its_targets_are_about(task):
    for episode in load_episodes(task, "val").episodes[::10]:
        links = episode.container_links()
        assert list(links) == list(CONTAINERS)
        assert all(link is None or link in CONTAINERS[name].links for name, link in links.items())
        starts = {episode.container(target) for target in range(len(episode.goals))} - {None}
        assert starts <= set(links.values())
        assert links["fridge"] == "top_door", "the only link is the one, also where no target is in it"
        assert (links["drawer"] is not None) == (task == "set_table")
