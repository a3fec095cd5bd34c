"""The three tasks against M3's own configuration files, copied here condition by condition."""

import numpy as np
import pytest

from perdure.errors import PerdureError
from perdure.home.sim.apartments import make_apartment
from perdure.home.tasks.planning import make_plan
from perdure.home.tasks.tasks import (
    NOTHING,
    SOMETHING_ELSE,
    TASKS,
    Predicate,
    Stage,
    Verb,
    WorldFacts,
    get_task,
)

# configs/rearrange/tasks/composite/*.yaml of hab-mobile-manipulation, arguments shortened
M3_SET_TABLE = {
    "open_0": "opened_drawer",
    "pick_0": "holding0",
    "place_0": "not_holding at0",
    "close_0": "closed_drawer at0",
    "open_1": "closed_drawer at0 opened_fridge",
    "pick_1": "closed_drawer at0 opened_fridge holding1",
    "place_1": "closed_drawer at0 not_holding at1",
    "close_1": "closed_drawer at0 closed_fridge at1",
}
M3_PICK_AND_PLACE = {
    "pick_0": "holding0",
    "place_0": "not_holding at0",
    "pick_1": "holding1 at0",
    "place_1": "not_holding at0 at1",
    "pick_2": "holding2 at0 at1",
    "place_2": "not_holding at0 at1 at2",
    "pick_3": "holding3 at0 at1 at2",
    "place_3": "not_holding at0 at1 at2 at3",
    "pick_4": "holding4 at0 at1 at2 at3",
    "place_4": "not_holding at0 at1 at2 at3 at4",
}
M3_STAGES = {
    "set_table": M3_SET_TABLE,
    "tidy_house": M3_PICK_AND_PLACE,
    "prepare_groceries": dict(list(M3_PICK_AND_PLACE.items())[:6]),
}
STAGES = [(task, stage) for task, stages in M3_STAGES.items() for stage in stages]


def short(condition):
    container = "" if condition.container is None else f"_{condition.container}"
    return condition.name + container + ("" if condition.target is None else str(condition.target))


@pytest.mark.parametrize("name", TASKS)
def test_stages_have_the_order_and_the_conditions_of_m3(name):
    ours = {stage.name: " ".join(map(short, stage.conditions)) for stage in TASKS[name].stages}
    assert ours == M3_STAGES[name]
    assert list(ours) == list(M3_STAGES[name])


def facts_that_meet(conditions, targets):
    """Facts just inside every threshold named, and far outside every other."""
    away = np.array([1.0, 0.0, 0.0])
    goals = np.arange(3.0 * targets).reshape(targets, 3)
    objects = goals + away
    held, containers = SOMETHING_ELSE, {"drawer": 0.25, "fridge": 0.8}
    inside = {("opened", "drawer"): 0.4001, ("closed", "drawer"): 0.0999}
    inside |= {("opened", "fridge"): 1.4201, ("closed", "fridge"): 0.1499}
    for condition in conditions:
        if condition.name == "at":
            objects[condition.target] = goals[condition.target] + [0.0, 0.1499, 0.0]
        held = {"holding": condition.target, "not_holding": NOTHING}.get(condition.name, held)
        if condition.container is not None:
            containers[condition.container] = inside[condition.name, condition.container]
    return {"object_positions": objects, "goal_positions": goals, "held": held, "containers": containers}


def broken(values, condition, targets):
    """The same facts with one condition missed by a tenth of a millimeter or milliradian, or by the wrong grasp."""
    off = {name: dict(value) if name == "containers" else np.copy(value) for name, value in values.items()}
    if condition.name == "at":
        off["object_positions"][condition.target] = values["goal_positions"][condition.target] + [0.0, 0.1501, 0.0]
    elif condition.name in ("holding", "not_holding"):
        wrong = (condition.target + 1) % targets if condition.name == "holding" else SOMETHING_ELSE
        off["held"] = np.array(wrong)
    else:
        edges = {("opened", "drawer"): 0.3999, ("closed", "drawer"): 0.1001}
        edges |= {("opened", "fridge"): 1.4199, ("closed", "fridge"): 0.1501}
        off["containers"][condition.container] = edges[condition.name, condition.container]
    return off


def make(values):
    containers = {name: np.asarray(position) for name, position in values["containers"].items()}
    others = {name: np.asarray(value) for name, value in values.items() if name != "containers"}
    return WorldFacts(**others, containers=containers)


@pytest.mark.parametrize(("task", "stage"), STAGES)
def test_stage_is_met_just_inside_its_conditions_and_not_with_any_one_of_them_just_missed(task, stage):
    targets, checked = len(TASKS[task].targets), next(each for each in TASKS[task].stages if each.name == stage)
    values = facts_that_meet(checked.conditions, targets)
    assert checked.met(make(values))
    for condition in checked.conditions:
        assert not checked.met(make(broken(values, condition, targets))), str(condition)


def test_an_object_counts_as_there_up_to_a_ball_of_15_centimeters_in_space():
    inside = {"held": np.zeros(3, dtype=int), "containers": {}}
    # 0.05^2 + 0.1^2 + 0.1^2 = 0.15^2
    offsets = np.array([[0.05, 0.1, 0.0999], [0.05, 0.1, 0.1001], [0.0, 0.0, -0.1499]])
    facts = WorldFacts(object_positions=offsets[:, None] + 2.0, goal_positions=np.full((1, 3), 2.0), **inside)
    assert Predicate("at", 0).holds(facts).tolist() == [True, False, True]


def test_a_handle_in_the_hand_is_neither_a_target_nor_nothing():
    values = facts_that_meet((), 2)
    facts = make(values | {"held": SOMETHING_ELSE})
    assert not Predicate("not_holding").holds(facts)
    assert not Predicate("holding", 0).holds(facts)


def test_numbers_of_targets_objects_and_steps_are_those_of_m3():
    counts = {
        name: (len(task.targets), sum(number for number, _ in task.clutter), task.max_steps)
        for name, task in TASKS.items()
    }
    assert counts == {"tidy_house": (5, 20, 5000), "prepare_groceries": (3, 22, 4000), "set_table": (2, 23, 4500)}
    assert {name: dict(task.opened) for name, task in TASKS.items()} == {
        "tidy_house": {},
        "prepare_groceries": {"top_door": 2.356},
        "set_table": {},
    }


def test_set_table_brings_the_bowl_from_a_drawer_and_the_apple_from_the_middle_shelf():
    bowl, apple = get_task("set_table").targets
    assert bowl.start.objects == ("024_bowl",)
    assert apple.start.objects == ("013_apple",)
    assert all("drawer" in name and "_top_" in name for name in bowl.start.receptacles)
    assert len(bowl.start.receptacles) == 3
    assert apple.start.receptacles == ("receptacle_aabb_middle_topfrl_apartment_refrigerator",)
    assert apple.start.ratio[apple.start.receptacles[0]] == 0.5
    assert bowl.goal.receptacles == apple.goal.receptacles
    assert all("table_0" in name for name in bowl.goal.receptacles)


def test_every_receptacle_of_every_task_is_in_the_apartments():
    apartment = make_apartment(0, 0)
    for task in TASKS.values():
        rules = [rule for target in task.targets for rule in (target.start, target.goal)]
        for rule in rules + [rule for _, rule in task.clutter]:
            assert all(apartment.receptacles_named(name) for name in rule.receptacles)
        assert all(apartment.articulation(link).limit[1] >= q for link, q in task.opened.items())


SET_TABLE_SKILLS = [
    *("navigate", "open_drawer", "pick", "navigate", "place", "navigate", "close_drawer"),
    *("navigate", "open_fridge", "navigate", "pick", "navigate", "place", "navigate", "close_fridge"),
]


def test_set_table_runs_the_skill_sequence_of_m3():
    steps = make_plan("set_table")
    assert [step.skill for step in steps[::2]] == SET_TABLE_SKILLS
    assert {step.skill for step in steps[1::2]} == {"reset_arm"}
    assert [step.target for step in steps] == [0] * 14 + [1] * 16
    assert [step.toward for step in steps if step.skill == "navigate"] == [
        "open_drawer",
        "place",
        "close_drawer",
        "open_fridge",
        "pick",
        "place",
        "close_fridge",
    ]


@pytest.mark.parametrize(("name", "targets"), [("tidy_house", 5), ("prepare_groceries", 3)])
def test_pick_and_place_tasks_run_the_skill_sequence_of_m3(name, targets):
    steps = make_plan(name)
    once = ["navigate", "reset_arm", "pick", "reset_arm", "navigate", "reset_arm", "place", "reset_arm"]
    assert [step.skill for step in steps] == once * targets
    assert [step.target for step in steps[::8]] == list(range(targets))


@pytest.mark.parametrize(
    ("given", "word"),
    [
        (("at",), "target"),
        (("not_holding", 0), "target"),
        (("opened", 0), "target"),
        (("holding", 0, "drawer"), "container"),
        (("closed",), "container"),
        (("closed", None, "frige"), "did you mean 'fridge'"),
        (("near", 0), "at, holding, not_holding, opened, closed"),
    ],
)
def test_conditions_that_there_are_not_are_refused(given, word):
    with pytest.raises(PerdureError, match=word):
        Predicate(*given)


@pytest.mark.parametrize("verb", [Verb.NAVIGATE, Verb.RESET_ARM])
def test_a_stage_is_about_picking_placing_opening_or_closing(verb):
    with pytest.raises(PerdureError, match="pick, place, open, close"):
        Stage(verb, 0, ())


def test_facts_that_lack_a_container_say_so_only_when_it_is_asked_for():
    facts = make(
        {"object_positions": np.zeros((1, 3)), "goal_positions": np.zeros((1, 3)), "held": 0, "containers": {}}
    )
    assert Predicate("at", 0).holds(facts)
    with pytest.raises(PerdureError, match="'fridge'"):
        Predicate("opened", container="fridge").holds(facts)


def test_unknown_tasks_stages_and_targets_are_refused():
    with pytest.raises(PerdureError, match="tidy_house, prepare_groceries, set_table"):
        get_task("clean_up")
    with pytest.raises(PerdureError, match="know 2 targets"):
        Predicate("at", 2).holds(make(facts_that_meet((), 2)))


@pytest.mark.parametrize(
    ("name", "value", "word"),
    [
        ("containers", {"drawer": np.zeros(4)}, "drawer"),
        ("containers", {"fridge": np.zeros((3, 1))}, "fridge"),
        ("containers", {"wardrobe": np.zeros(3)}, "wardrobe"),
        ("object_positions", np.zeros((3, 2, 2)), "shape"),
        ("object_positions", np.zeros((2, 2, 3)), "shape"),
        ("goal_positions", np.zeros((1, 3)), "goal_positions"),
    ],
)
def test_facts_that_do_not_fit_together_are_refused(name, value, word):
    good = {
        "object_positions": np.zeros((3, 2, 3)),
        "goal_positions": np.zeros((2, 3)),
        "held": np.zeros(3, dtype=int),
        "containers": {"drawer": np.zeros(3), "fridge": np.zeros(3)},
    }
    WorldFacts(**good)
    with pytest.raises(PerdureError, match=word):
        WorldFacts(**good | {name: value})
