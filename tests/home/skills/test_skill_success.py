"""Each skill's success: true when all its conditions hold, false when any single one is one step or a hair off."""

import numpy as np
import pytest
from hand_made import BOWL, DRAWER, OTHER, change, course, gripper_off, state, succeeds

from perdure.errors import PerdureError
from perdure.home.sim.robot import ROBOT
from perdure.home.skills import (
    SKILLS,
    CloseDrawer,
    CloseFridge,
    Navigate,
    OpenDrawer,
    OpenFridge,
    Pick,
    Place,
    get_skill,
)

HELD = state(held=BOWL, object=[1.0, 0.0, 0.8])
PLACED = change(HELD, held=-1, object=[1.0, 0.149, 0.8], **gripper_off(0.049))
"""0.149 m from its goal, let go, the gripper 0.049 m from rest."""


def test_place_succeeds_within_15_cm_of_the_goal_with_an_empty_hand_at_rest():
    assert succeeds(Place(), HELD, PLACED)


@pytest.mark.parametrize(
    "off",
    [
        {"object": [1.0, 0.151, 0.8]},
        {"object": [1.0, 0.11, 0.91]},  # 0.1556 m away, each coordinate within 0.15
        {"held": BOWL},
        gripper_off(0.051),
    ],
    ids=["too far", "too far in space", "still held", "not at rest"],
)
def test_place_does_not_succeed_when_one_condition_is_off(off):
    assert not succeeds(Place(), HELD, change(PLACED, **off))


@pytest.mark.parametrize(
    ("steps", "unmet"),
    [
        ([HELD], ["not let go", "object not in its goal", "object not long enough in its goal"]),
        ([PLACED], ["object not long enough in its goal"]),
        ([PLACED, PLACED], []),
        (
            [PLACED, change(PLACED, object=[1.0, 0.5, 0.8])],
            ["object not in its goal", "object not long enough in its goal"],
        ),
        ([PLACED, change(PLACED, **gripper_off(0.06))], ["gripper not at rest"]),
    ],
)
def test_place_names_its_unmet_conditions_and_has_none_exactly_when_it_succeeds(steps, unmet):
    skill = Place(delta=2)
    moments = [HELD, *steps]
    progress = course(skill, *moments)
    assert [what for what, so in skill.unmet(moments[-1], progress).items() if so[0]] == unmet
    assert succeeds(skill, *moments) == (not unmet)


@pytest.mark.parametrize("delta", [1, 2, 30])
def test_place_succeeds_after_delta_steps_and_not_one_step_earlier(delta):
    skill = Place(delta=delta)
    assert succeeds(skill, HELD, *[PLACED] * delta)
    assert delta == 1 or not succeeds(skill, HELD, *[PLACED] * (delta - 1))


@pytest.mark.parametrize("off", [{"object": [1.0, 0.151, 0.8]}, {"held": BOWL}], ids=["out of the goal", "held"])
def test_a_break_of_one_step_makes_the_count_begin_anew(off):
    skill, away = Place(delta=5), change(PLACED, **off)
    assert not succeeds(skill, HELD, *[PLACED] * 4, away, *[PLACED] * 4)
    assert succeeds(skill, HELD, *[PLACED] * 4, away, *[PLACED] * 5)


def test_the_gripper_need_not_be_at_rest_while_the_steps_are_counted():
    reaching = change(PLACED, **gripper_off(0.4))
    assert succeeds(Place(delta=5), HELD, *[reaching] * 4, PLACED)
    assert not succeeds(Place(delta=5), HELD, *[PLACED] * 4, reaching)


def test_another_object_in_the_hand_does_not_count_as_holding_the_target():
    assert succeeds(Place(), HELD, change(PLACED, held=OTHER))


def test_a_delta_that_makes_no_sense_is_refused():
    with pytest.raises(PerdureError, match="delta must be 1 step or more, not 0"):
        Place(delta=0)


def test_a_place_that_must_last_longer_may_take_longer():
    assert (Place().limit, Place(delta=30).limit) == (200, 230)


PICKED = state(held=BOWL, **gripper_off(0.049))


def test_pick_succeeds_with_the_target_held_at_rest():
    assert succeeds(Pick(), state(), PICKED)


@pytest.mark.parametrize(
    "off", [{"held": -1}, {"held": OTHER}, gripper_off(0.051)], ids=["empty", "another object", "not at rest"]
)
def test_pick_does_not_succeed_when_one_condition_is_off(off):
    assert not succeeds(Pick(), state(), change(PICKED, **off))


HALF_PI = np.pi / 2.0
RANGES = [
    (OpenDrawer, 0.401, 0.499, 0.399),
    (OpenDrawer, 0.401, 0.504, 0.506),
    (CloseDrawer, 0.0, 0.049, 0.051),
    (OpenFridge, HALF_PI + 0.101, 2.3, HALF_PI + 0.099),
    (CloseFridge, 0.0, 0.149, 0.151),
]


@pytest.mark.parametrize(("skill", "first", "last", "outside"), RANGES)
def test_opening_and_closing_succeed_in_their_range_of_the_joint_only(skill, first, last, outside):
    for q in (first, last):
        assert succeeds(skill(), state(link_position=q, **gripper_off(0.149)))
    assert not succeeds(skill(), state(link_position=outside, **gripper_off(0.149)))


@pytest.mark.parametrize(("skill", "q"), [(each[0], each[1]) for each in RANGES[1:]])
@pytest.mark.parametrize(
    "off", [{"held_link": DRAWER}, {"held": OTHER}, gripper_off(0.151)], ids=["handle", "object", "not at rest"]
)
def test_opening_and_closing_do_not_succeed_when_one_condition_is_off(skill, q, off):
    assert not succeeds(skill(), state(link_position=q, **{**gripper_off(0.149), **off}))


ARRIVED = state(way=0.099, facing_error=-0.249, stopped=True)


def test_navigate_succeeds_when_it_stops_near_the_region_turned_to_the_aim():
    assert succeeds(Navigate(), ARRIVED)


@pytest.mark.parametrize("off", [{"way": 0.101}, {"facing_error": 0.251}, {"facing_error": -0.251}])
def test_navigate_that_stops_elsewhere_has_failed_and_the_executor_goes_on(off):
    skill, there = Navigate(), change(ARRIVED, **off)
    assert not succeeds(skill, there)
    assert skill.failure_labels[skill.failure(there, course(skill, there))[0]] == "stopped elsewhere"
    assert skill.stop(there, course(skill, there))[0]


@pytest.mark.parametrize("speed", [[0.06, 0.0, 0.0], [0.0, 0.0, -0.06]])
def test_navigate_goes_on_until_it_says_stop(speed):
    skill, silent = Navigate(), change(ARRIVED, stopped=False, base_velocity=speed)
    assert not succeeds(skill, *[silent] * 50)
    assert not skill.stop(silent, course(skill, *[silent] * 50))[0]
    assert skill.failure(silent, course(skill, silent))[0] == 0


def test_the_executor_ends_a_navigation_that_gets_nowhere():
    """One that rocks to and fro for three seconds, however fast; not one that drives away or turns on the spot."""
    skill = Navigate()

    def course_of(pose):
        moments = [state(base=np.array(pose(step)), base_velocity=np.array([0.5, 0.0, 2.0])) for step in range(200)]
        progress = skill.begin(moments[0])
        for step, moment in enumerate(moments[1:], 2):
            progress = skill.advance(progress, moment)
            if skill.stop(moment, progress)[0]:
                assert skill.failure(moment, progress)[0] == 0, "in training it goes on"
                return step
        return None

    assert course_of(lambda step: (0.0, 0.0, 0.0)) == 90
    assert course_of(lambda step: (0.05 * np.sin(step), 0.03 * np.cos(step), 3.1 + 0.35 * np.sin(step))) == 90
    assert course_of(lambda step: (0.004 * step, 0.0, 0.0)) is None
    assert course_of(lambda step: (0.0, 0.0, 0.03 * step)) is None


def test_the_map_stops_navigation_unless_somebody_knows_better():
    skill, silent = Navigate(), change(ARRIVED, stopped=False)
    for stop, wanted, where in ((0.0, 1.0, silent), (-1.0, -1.0, silent), (0.0, 0.0, change(silent, way=0.2))):
        action = np.full((1, ROBOT.action_size), 0.5)
        action[0, ROBOT.action.stop] = stop
        masked = skill.mask(action, where)
        assert masked[0, ROBOT.action.stop] == wanted
        assert (masked[0, [ROBOT.action.forward, ROBOT.action.turn]] == 0.5).all()


def test_the_executor_stops_place_without_looking_at_the_object():
    elsewhere = change(PLACED, object=[3.0, 0.0, 0.0])
    skill = Place()
    assert skill.stop(elsewhere, course(skill, HELD, elsewhere))[0]
    assert not skill.success(elsewhere, course(skill, HELD, elsewhere))[0]


def test_the_executor_stops_pick_with_whatever_it_holds():
    wrong = change(PICKED, held=OTHER)
    assert Pick().stop(wrong, course(Pick(), state(), wrong))[0]


def test_the_executor_stops_opening_only_after_the_gripper_was_away():
    skill, done, away = OpenDrawer(), state(link_position=0.45), state(**gripper_off(0.31))
    assert not skill.stop(done, course(skill, done))[0]
    assert not skill.stop(done, course(skill, state(**gripper_off(0.29)), done))[0]
    assert skill.stop(done, course(skill, away, done))[0]


def test_skills_are_found_by_name():
    assert sorted(SKILLS) == sorted(
        ["pick", "place", "open_drawer", "close_drawer", "open_fridge", "close_fridge", "navigate", "reset_arm"]
    )


def test_skills_are_stopped_after_the_steps_of_m3():
    limits = {name: get_skill(name).limit for name in SKILLS}
    assert limits.pop("navigate") == 500
    assert limits.pop("reset_arm") == 50
    assert set(limits.values()) == {200}


def test_an_unknown_skill_is_refused_with_the_nearest_name():
    with pytest.raises(PerdureError, match=r"open_drawr.*did you mean 'open_drawer'"):
        get_skill("open_drawr")


def test_navigation_without_a_next_skill_is_refused():
    with pytest.raises(PerdureError, match="needs toward"):
        Navigate().skill_goal(None, 0, {})
