"""Errands: goals for objects where they are now, in a home that is never reset."""

from dataclasses import replace

import numpy as np
import pytest

from perdure.home.sim.apartments import split_apartments
from perdure.home.tasks.episodes import load_episodes
from perdure.home.tasks.errands import (
    NOWHERE,
    HomeState,
    draw_errand,
    errand_generator,
    find_receptacles,
    first_state,
)
from perdure.home.tasks.planning import make_plan
from perdure.home.tasks.tasks import get_task

TABLE = "receptacle_aabb_Tbl1_Top1_frl_apartment_table_01"


def draw(task, first, state, number=1):
    return draw_errand(task, first, state, errand_generator(0, 0, number, task))


def with_object(state, number, placement):
    objects = list(state.objects)
    objects[number] = placement
    return replace(state, objects=tuple(objects))


def moved(state, number, receptacle, apartment, above=0.05):
    """The state with an object in the middle of a receptacle."""
    each = next(found for found in apartment.receptacles if found.name == receptacle)
    x, y, z = apartment.surface_to_room(each, np.zeros(2)).tolist()
    placement = replace(state.objects[number], position=(x, y, z + above), receptacle=each.unique_name)
    return with_object(state, number, placement)


def kind_number(state, kind):
    return next(k for k, each in enumerate(state.objects) if each.kind == kind)


@pytest.fixture(scope="module")
def tidy():
    return first_state(("tidy_house",), "eval", 0, 0)


@pytest.fixture(scope="module")
def table():
    return first_state(("set_table",), "eval", 0, 0)


@pytest.mark.parametrize("task", ["tidy_house", "set_table", "prepare_groceries"])
def test_published_objects_lie_on_their_receptacles(task):
    """Tables, counters, drawers and both shelves of the fridge: the published file says where each object lies."""
    for episode in load_episodes(task, "eval").episodes[:30:10]:
        apartment = episode.apartment()
        points = np.array([placement.position for placement in episode.objects])
        found = find_receptacles(apartment, points, episode.opened)
        assert found == [placement.receptacle for placement in episode.objects]


def test_the_floor_and_the_air_are_no_receptacle(tidy):
    first, _ = tidy
    x, y, z = first.objects[0].position
    apartment = first.apartment()
    points = np.array([[x, y, 0.05], [x, y, z], [x, y, z + 0.4]])
    assert find_receptacles(apartment, points, {}) == [NOWHERE, first.objects[0].receptacle, NOWHERE]


def test_an_object_in_an_open_drawer_moves_with_it(table):
    first, _ = table
    apartment = first.apartment()
    link = first.container(0)
    drawer = apartment.receptacle(first.objects[0].receptacle)
    inside = apartment.surface_to_room(drawer, np.zeros(2), {link: 0.4})
    inside[2] += 0.03
    assert find_receptacles(apartment, inside[None], {link: 0.4}) == [drawer.unique_name]
    assert find_receptacles(apartment, inside[None], {link: 0.0}) == [NOWHERE]


def test_targets_are_taken_from_where_they_are_now(tidy):
    """All bowls and cans but five objects lie on the floor: these five are the targets, from where they lie."""
    first, state = tidy
    left = [0, 3, 7, 11, 20]
    for number in set(range(25)) - set(left):
        x, y, _ = state.objects[number].position
        state = with_object(state, number, replace(state.objects[number], position=(x, y, 0.05), receptacle=NOWHERE))
    state = moved(state, 11, TABLE, first.apartment())
    errand = draw("tidy_house", first, state)
    assert sorted(errand.numbers[:5]) == left
    assert [errand.objects[k] for k in range(25)] == [state.objects[number] for number in errand.numbers]
    assert errand.objects[errand.numbers.index(11)].receptacle == f"table_01|{TABLE}"
    distances = np.linalg.norm(errand.goal_positions - np.array([each.position for each in errand.objects[:5]]), axis=1)
    assert (distances >= 0.5).all()
    rules = get_task("tidy_house").targets
    assert all(g.receptacle.split("|")[1] in r.goal.receptacles for g, r in zip(errand.goals, rules, strict=True))
    # One fewer, and there is no errand left.
    x, y, _ = state.objects[20].position
    state = with_object(state, 20, replace(state.objects[20], position=(x, y, 0.05), receptacle=NOWHERE))
    assert draw("tidy_house", first, state) is None


def test_goals_are_free_of_every_object_where_it_is_now(tidy):
    first, state = tidy
    crowded = [k for k, each in enumerate(state.objects) if "Tbl1" in each.receptacle]
    assert crowded
    for number in range(1, 6):
        errand = draw("tidy_house", first, state, number)
        for goal in errand.goals:
            for other in state.objects:
                if other.receptacle == goal.receptacle:
                    assert np.linalg.norm(np.subtract(goal.position, other.position)[:2]) > 0.03


def test_a_draw_depends_on_its_seeds_only(tidy):
    first, state = tidy
    assert draw("tidy_house", first, state, 3) == draw("tidy_house", first, state, 3)
    assert draw("tidy_house", first, state, 3) != draw("tidy_house", first, state, 4)


def test_usual_places_come_first_and_other_places_after_them(table):
    """The bowl is taken from its drawer; on a table there is no drawer to open, and none to close."""
    first, state = table
    usual = draw("set_table", first, state)
    assert [stage.name for stage in usual.home_task.stages] == [s.name for s in get_task("set_table").stages]
    assert [step.skill for step in make_plan(usual)] == [step.skill for step in make_plan("set_table")]
    bowl = kind_number(state, "024_bowl")
    errand = draw("set_table", first, moved(state, bowl, TABLE, first.apartment()))
    stages = errand.home_task.stages
    assert [stage.name for stage in stages] == ["pick_0", "place_0", "open_1", "pick_1", "place_1", "close_1"]
    assert {each.container for stage in stages for each in stage.conditions} == {None, "fridge"}
    for task in (errand, errand.home_task):
        skills = [step.skill for step in make_plan(task)]
        assert "open_drawer" not in skills
        assert skills[-2] == "close_fridge"


def test_a_bowl_in_the_fridge_leaves_the_drawer_alone(table):
    """No stage is about the drawer, and the fridge, in which both targets are, is opened and closed for the apple."""
    first, state = table
    bowl = kind_number(state, "024_bowl")
    shelf = "receptacle_aabb_middle_topfrl_apartment_refrigerator"
    errand = draw("set_table", first, moved(state, bowl, shelf, first.apartment()))
    assert [stage.name for stage in errand.home_task.stages] == [
        *("pick_0", "place_0", "open_1", "pick_1", "place_1", "close_1")
    ]
    skills = [step.skill for step in make_plan(errand) if step.skill.endswith(("drawer", "fridge"))]
    assert skills == ["open_fridge", "close_fridge"]


def test_a_door_that_is_open_need_not_be_opened(table):
    first, state = table
    opened = draw("set_table", first, replace(state, positions={**state.positions, "top_door": 2.2}))
    assert opened.opened == {"top_door": 2.2}
    assert "open_fridge" not in [step.skill for step in make_plan(opened)]
    between = draw("set_table", first, replace(state, positions={**state.positions, "top_door": 0.5}))
    assert between.opened == {}
    assert between.positions["top_door"] == 0.5
    assert "open_fridge" in [step.skill for step in make_plan(between)]


def test_homes_are_other_apartments_and_have_what_all_errands_need():
    episodes = [first_state(("tidy_house",), "eval", home, 0)[0] for home in (0, 1, 2, 20)]
    assert [(each.macro, each.micro) for each in episodes] == [split_apartments("eval")[k] for k in (0, 1, 2, 0)]
    assert len({each.index for each in episodes}) == 4
    mixed, state = first_state(("tidy_house", "set_table", "prepare_groceries"), "eval", 0, 0)
    assert mixed.task == "set_table"
    for task in ("tidy_house", "set_table", "prepare_groceries"):
        assert draw(task, mixed, state) is not None
    assert first_state(("tidy_house",), "eval", 0, 1)[1].base != first_state(("tidy_house",), "eval", 0, 0)[1].base


def test_nearly_closed_doors_are_closed():
    state = HomeState((), {"top_door": 0.001, "drawer2_top": 0.2, "elsewhere": 1.0}, None, ())
    assert state.opened == {"drawer2_top": 0.2}
