"""The planner's plans: against the benchmark's own sequences, an interpreter of our own, and counted shortest plans."""

import os
import subprocess
import sys
from dataclasses import replace

import pytest
from strips import parse, shortest_plans

from perdure.errors import PerdureError
from perdure.home import TASKS, Episode
from perdure.home.sim.objects import Placement
from perdure.home.tasks.domain import HOME
from perdure.home.tasks.episodes import load_episodes
from perdure.home.tasks.pddl import domain_pddl, problem_pddl
from perdure.home.tasks.planning import make_plan, plan_problem
from perdure.home.tasks.strips import ground
from perdure.home.tasks.tasks import PlacementRule, Predicate, Stage, TargetRule, Verb

PANTRY, (TABLE_1, _) = TASKS["tidy_house"].targets[0].start.objects, TASKS["set_table"].targets[0].goal.receptacles
DRAWERS, (FRIDGE_MIDDLE,) = (target.start.receptacles for target in TASKS["set_table"].targets)
COUNTER_LEFT = TASKS["prepare_groceries"].targets[0].goal.receptacles[1]
FRIDGE_OPEN = {"top_door": 2.356}
VARIANTS = {
    **TASKS,
    "table_set_from_an_open_fridge": replace(TASKS["set_table"], opened=FRIDGE_OPEN),
    "groceries_in_a_closed_fridge": replace(TASKS["prepare_groceries"], opened={}),
}
PICK_AND_PLACE = ["navigate", "pick", "navigate", "place"]


def skills(plan):
    return [step.skill for step in plan if step.skill != "reset_arm"]


def world_of(task):
    return parse(domain_pddl(HOME), problem_pddl(plan_problem(task)))


def episode(drawer=DRAWERS[0], opened=None):
    """SetTable with the bowl in a given drawer; where things lie plays no part in planning."""

    def put(kind, receptacle):
        return Placement(kind, (0.0, 0.0, 0.5), (1.0, 0.0, 0.0, 0.0), receptacle)

    bowl, apple = put("024_bowl", f"kitchen_counter|{drawer}"), put("013_apple", f"refrigerator|{FRIDGE_MIDDLE}")
    clutter = (put("004_sugar_box", f"table_01|{TABLE_1}"),) * 23
    goals = (put("024_bowl", f"table_01|{TABLE_1}"), put("013_apple", f"table_01|{TABLE_1}"))
    return Episode("set_table", "val", 3, 0, 16, "none", opened or {}, (bowl, apple, *clutter), goals)


AT_GOAL = Predicate("at", 0)


def one_target(start, goal, conditions=(AT_GOAL,), opened=None):
    rule = TargetRule(PlacementRule(PANTRY, (start,)), PlacementRule(PANTRY, (goal,)))
    stages = (Stage(Verb.PLACE, 0, conditions),)
    return replace(TASKS["tidy_house"], name="mine", targets=(rule,), stages=stages, opened=opened or {})


SEQUENCES = {
    "tidy_house": [(skill, target) for target in range(5) for skill in PICK_AND_PLACE],
    "prepare_groceries": [(skill, target) for target in range(3) for skill in PICK_AND_PLACE],
    "set_table": [
        *[("navigate", 0), ("open_drawer", 0), ("pick", 0)],  # straight after the drawer is open, without navigating
        *[("navigate", 0), ("place", 0), ("navigate", 0), ("close_drawer", 0)],
        *[("navigate", 1), ("open_fridge", 1), ("navigate", 1), ("pick", 1)],
        *[("navigate", 1), ("place", 1), ("navigate", 1), ("close_fridge", 1)],
    ],
}
"""M3's sequences (`configs/rearrange/composite/*`), without `reset_arm` after each skill."""


@pytest.mark.parametrize("name", TASKS)
def test_the_plan_is_the_benchmarks_own_sequence(name):
    plan = make_plan(name)
    assert [(step.skill, step.target) for step in plan[::2]] == SEQUENCES[name]
    assert {step.skill for step in plan[1::2]} == {"reset_arm"}
    pairs = zip(plan[:-2:2], plan[2::2], strict=True)
    assert all(step.toward == (following.skill if step.skill == "navigate" else None) for step, following in pairs)
    assert make_plan(TASKS[name]) == plan


@pytest.mark.parametrize("name", VARIANTS)
def test_there_is_exactly_one_shortest_plan_and_it_is_the_one_made(name):
    world = world_of(VARIANTS[name])
    length, number, actions = shortest_plans(world)
    assert number == 1
    assert world.goal <= world.after(actions)
    own = [(action[0], int(action[1][-1])) for action in actions if action[0] != "next_target"]
    made = [(step.skill, step.target) for step in make_plan(VARIANTS[name]) if step.skill != "reset_arm"]
    assert made == own
    assert length == len(own) + len(VARIANTS[name].targets) - 1


@pytest.mark.parametrize("name", VARIANTS)
def test_another_reader_finds_the_same_problem_in_the_printed_pddl(name):
    problem = plan_problem(VARIANTS[name])
    printed = world_of(VARIANTS[name])
    ours = ground(HOME, problem.objects, frozenset(problem.start), frozenset(problem.final))
    assert (printed.start, printed.goal) == (ours.start, ours.goal)
    theirs = {(each.name, each.needs, each.adds, each.deletes) for each in printed.actions.values()}
    assert {((each.name, *each.arguments), each.needs, each.adds, each.deletes) for each in ours.actions} == theirs


# How many orders there are of what cannot be torn apart. TidyHouse, PrepareGroceries: bring a target; 5! and 3!.
# SetTable: bring the bowl, close the drawer, among: open the fridge, bring the apple, close the fridge; 5! / (2! 3!).
@pytest.mark.parametrize(("name", "orders"), [("tidy_house", 120), ("prepare_groceries", 6), ("set_table", 10)])
def test_without_the_order_of_targets_every_other_order_is_a_shortest_plan_too(name, orders):
    lines = problem_pddl(plan_problem(name)).splitlines()
    turns = [f"(turn target_{i})" for i in range(1, len(TASKS[name].targets))]
    free = [line for line in lines if "(next " not in line]
    free[free.index("    (hand_empty)") : 0] = turns
    length, number, _ = shortest_plans(parse(domain_pddl(HOME), "\n".join(free)))
    assert (length, number) == (len(skills(make_plan(TASKS[name]))), orders)


def bring_bowl(world, *names):
    return world.after(
        [{"to drawer": ("navigate", "target_0", "elsewhere", "drawer1_top"),
          "to bowl": ("navigate", "target_0", "elsewhere", "target_0"),
          "open": ("open_drawer", "target_0", "drawer1_top"),
          "pick": ("pick", "target_0", "drawer1_top"),
          "back": ("navigate", "target_0", "target_0", "drawer1_top"),
          "close": ("close_drawer", "target_0", "drawer1_top")}[name] for name in names]
    )  # fmt: skip


def test_nothing_is_picked_from_a_closed_drawer():
    world = world_of(episode())
    assert bring_bowl(world, "to bowl") is not None
    assert bring_bowl(world, "to bowl", "pick") is None
    assert bring_bowl(world, "to drawer", "open", "pick") is not None
    assert bring_bowl(world, "to drawer", "open", "back", "close", "pick") is None


def test_doors_are_moved_with_an_empty_hand_only():
    world = world_of(episode())
    assert bring_bowl(world, "to drawer", "open", "back", "close") is not None
    assert bring_bowl(world, "to drawer", "open", "pick", "back") is not None
    assert bring_bowl(world, "to drawer", "open", "pick", "back", "close") is None


def test_an_open_drawer_leaves_the_robot_at_the_bowl_and_an_open_fridge_does_not_leave_it_at_the_apple():
    apple_first = problem_pddl(plan_problem("set_table")).replace("(turn target_0)", "(turn target_1)")
    opened = [("navigate", "target_1", "elsewhere", "top_door"), ("open_fridge", "target_1", "top_door")]
    world = parse(domain_pddl(HOME), apple_first)
    assert world.after([*opened, ("pick", "target_1", "top_door")]) is None
    assert world.after([*opened, ("navigate", "target_1", "elsewhere", "target_1"), ("pick", "target_1", "top_door")])
    assert bring_bowl(world_of(episode()), "to drawer", "open", "pick") is not None


def test_an_open_fridge_need_not_be_opened():
    plan = make_plan(VARIANTS["table_set_from_an_open_fridge"])
    drawer = ["navigate", "open_drawer", "pick", "navigate", "place", "navigate", "close_drawer"]
    assert skills(plan) == [*drawer, *PICK_AND_PLACE, "navigate", "close_fridge"]


def test_groceries_in_a_closed_fridge_begin_with_opening_it_once():
    plan = make_plan(VARIANTS["groceries_in_a_closed_fridge"])
    assert skills(plan) == ["navigate", "open_fridge", *PICK_AND_PLACE * 3]
    assert [step.target for step in plan[:4]] == [0] * 4
    assert plan[0].toward == "open_fridge"


@pytest.mark.parametrize(("side", "link"), [("left", "drawer1_top"), ("middle", "drawer2_top"), ("right", "drawer3")])
def test_an_episode_says_which_drawer_and_plans_what_its_task_does(side, link):
    (drawer,) = (name for name in DRAWERS if f"_{side}_" in name)
    task = problem_pddl(plan_problem("set_table")).replace("some_drawer", link)
    printed = problem_pddl(plan_problem(episode(drawer)))
    assert printed.replace("plan_set_table_val_003", "plan_set_table") == task
    assert make_plan(episode(drawer)) == make_plan(TASKS["set_table"])


def test_a_drawer_that_stands_open_is_closed_but_not_opened():
    plan = make_plan(episode(opened={"drawer1_top": 0.4}))
    assert skills(plan)[:6] == [*PICK_AND_PLACE, "navigate", "close_drawer"]
    assert make_plan(episode(opened={"drawer2_top": 0.4})) == make_plan(TASKS["set_table"])


@pytest.mark.parametrize(
    ("opened", "words"), [({"drawer1_top": 0.25}, "drawer1_top.*0.25.*0.4"), ({"top_door": 1.4}, "top_door.*1.4.*1.42")]
)
def test_a_door_that_is_neither_open_nor_closed_is_refused(opened, words):
    with pytest.raises(PerdureError, match=words):
        make_plan(episode(opened=opened))


def test_a_task_without_a_plan_is_named_with_what_cannot_be_reached():
    with pytest.raises(PerdureError, match=r"no plan solves mine: .*\(at_goal target_0\)"):
        make_plan(one_target(COUNTER_LEFT, DRAWERS[0]))  # a drawer is opened for what lies in it
    assert skills(make_plan(one_target(COUNTER_LEFT, FRIDGE_MIDDLE)))[:2] == ["navigate", "open_fridge"]
    assert skills(make_plan(one_target(COUNTER_LEFT, FRIDGE_MIDDLE, opened=FRIDGE_OPEN))) == PICK_AND_PLACE
    with pytest.raises(PerdureError, match=r"no plan solves mine: .*\(holding target_0\)"):
        make_plan(one_target(COUNTER_LEFT, TABLE_1, (Predicate("holding", 0),)))


def test_a_last_stage_that_wants_the_fridge_open_leaves_it_open():
    task = one_target(FRIDGE_MIDDLE, TABLE_1, (AT_GOAL, Predicate("opened", container="fridge")))
    assert skills(make_plan(task)) == ["navigate", "open_fridge", *PICK_AND_PLACE]
    closed = one_target(FRIDGE_MIDDLE, TABLE_1, (AT_GOAL, Predicate("closed", container="fridge")))
    assert skills(make_plan(closed))[-2:] == ["navigate", "close_fridge"]


def test_tasks_that_cannot_be_put_as_a_problem_are_refused_with_the_reason():
    with pytest.raises(PerdureError, match="set_table"):
        make_plan("lay_table")
    with pytest.raises(PerdureError, match="no targets"):
        make_plan(replace(TASKS["tidy_house"], targets=()))
    with pytest.raises(PerdureError, match=r"closed\(drawer\), but none of its targets is in a drawer"):
        make_plan(one_target(COUNTER_LEFT, TABLE_1, (Predicate("closed", container="drawer"),)))
    with pytest.raises(PerdureError, match="'shelf'"):
        make_plan(one_target("shelf", TABLE_1))
    either = replace(TASKS["set_table"], opened={"drawer2_top": 0.5})  # open or closed, as the bowl's drawer is drawn
    with pytest.raises(PerdureError, match=r"drawer1_top, drawer2_top, drawer3.*episode"):
        make_plan(either)
    bowls = (TASKS["set_table"].targets[0],) * 2  # in the same drawer or not
    with pytest.raises(PerdureError, match=r"several targets of set_table.*episode"):
        make_plan(replace(TASKS["set_table"], targets=bowls, stages=()))
    mixed = TargetRule(PlacementRule(PANTRY, (TABLE_1, FRIDGE_MIDDLE)), PlacementRule(PANTRY, (TABLE_1,)))
    with pytest.raises(PerdureError, match="in the open, top_door"):
        make_plan(replace(one_target(TABLE_1, TABLE_1), targets=(mixed,)))


def test_any_name_will_do_for_a_task():
    odd = replace(TASKS["set_table"], name="2 für (den) Tisch")
    assert make_plan(odd) == make_plan(TASKS["set_table"])
    assert world_of(odd).goal == world_of(TASKS["set_table"]).goal


@pytest.mark.parametrize("every", [20, pytest.param(1, marks=pytest.mark.verify)])
def test_every_published_episode_has_the_plan_of_its_task(every):
    for name, task in TASKS.items():
        for split in ("val", "eval", "eval-2"):
            assert {make_plan(each) for each in load_episodes(name, split).episodes[::every]} == {make_plan(task)}


def test_planning_starts_no_program(tmp_path):
    """A planner that asks `git` for its version would run what the user's repository is set up to run."""
    git = tmp_path / "git"
    git.write_text(f"#!/bin/sh\ntouch {tmp_path}/started\n")
    git.chmod(0o755)
    environment = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"}
    for module, started in (("perdure.home.tasks.planning", False), ("unified_planning", True)):
        code = f"import {module} as m; getattr(m, 'make_plan', str)('set_table')"
        subprocess.run([sys.executable, "-c", code], env=environment, cwd=tmp_path, check=True, timeout=600)
        assert (tmp_path / "started").exists() is started


def test_the_goal_holds_the_closed_doors_of_tasks_that_close_them_and_no_others():
    assert set(plan_problem("set_table").final) >= {("closed", "some_drawer"), ("closed", "top_door"), ("hand_empty",)}
    assert not {"closed", "open"} & {fact[0] for fact in plan_problem("prepare_groceries").final}


def test_planning_prints_nothing_and_is_light():
    code = (
        "import sys; from perdure.home.tasks.planning import make_plan\n"
        "make_plan('prepare_groceries')\n"
        "heavy = {'unified_planning', 'pyperplan', 'mujoco', 'scipy', 'altair', 'jax'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
