"""Rewards and failures against numbers worked by hand from the benchmark's table."""

from dataclasses import replace

import numpy as np
import pytest
from hand_made import BOWL, DRAWER, OTHER, change, failure, gripper_off, random_state, state, step_reward

from perdure.home.sim.apartments import make_apartment
from perdure.home.sim.pieces import CONTAINERS
from perdure.home.sim.robot import ROBOT
from perdure.home.skills import (
    CloseDrawer,
    CloseFridge,
    Navigate,
    OpenDrawer,
    OpenFridge,
    Pick,
    Place,
    ResetArm,
    get_skill,
)
from perdure.home.skills.articulated import PAST_EDGE

FRIDGE_DOOR = CONTAINERS["fridge"].links[0]
HELD = state(held=BOWL, object=[1.0, 0.5, 0.8])


def close(value):
    return pytest.approx(value, abs=1e-12)


def test_carrying_the_object_10_cm_nearer_to_its_goal_earns_0_4():
    total, terms = step_reward(Place(), HELD, change(HELD, object=[1.0, 0.4, 0.8]))
    assert terms["carry"] == close(0.4)
    assert total == close(0.4 - 0.002)


def test_what_belongs_above_the_hand_is_lifted_and_what_belongs_below_comes_down_on_the_straight_line():
    below = change(HELD, object=[1.0, 0.3, 0.4])  # the goal is at (1, 0, 0.8): 0.3 m away, 0.4 m above
    assert step_reward(Place(), below, change(below, object=[1.0, 0.3, 0.5]))[1]["carry"] == close(4 * 0.1)
    assert step_reward(Place(), below, change(below, object=[1.0, 0.2, 0.4]))[1]["carry"] == close(4 * 0.1)
    above = change(HELD, object=[1.0, 0.3, 1.2])
    down = change(above, object=[1.0, 0.3, 1.1])
    assert step_reward(Place(), above, down)[1]["carry"] == close(4 * (0.5 - np.hypot(0.3, 0.3)))


def test_the_first_release_in_the_goal_earns_1_and_later_steps_nothing_more():
    inside = change(HELD, held=-1, object=[1.0, 0.1, 0.8], **gripper_off(0.4))
    total, terms = step_reward(Place(), change(HELD, object=[1.0, 0.1, 0.8]), inside)
    assert (terms["release"], terms["carry"], terms["failure"]) == (1.0, 0.0, 0.0)
    assert total == close(1.0 - 0.002)
    assert step_reward(Place(), HELD, inside, inside)[1]["release"] == 0.0


@pytest.mark.parametrize(
    ("hand", "speed", "paid"), [(0.0, 0.0, 10.0), (0.0, 0.03, 5.0), (0.01, 0.08, 2.5), (0.27, 0.0, 1.0)]
)
def test_a_gentle_release_is_paid_by_the_speeds_of_hand_and_object(hand, speed, paid):
    way = np.array([0.6, 0.8, 0.0]) * speed / 30 + [0.0, 0.0, -0.01]  # what falls is not in motion
    held = change(HELD, object=[1.0, 0.1, 0.8], gripper_velocity=[0.0, 0.0, -hand])
    inside = change(held, held=-1, object=np.array([1.0, 0.1, 0.8]) + way)
    assert step_reward(Place(gentle=True), held, inside)[1]["release"] == close(1.0 + paid)
    assert step_reward(Place(gentle=True), held, inside, inside)[1]["release"] == 0.0
    outside = change(inside, object=[1.0, 0.151, 0.8])
    assert step_reward(Place(gentle=True), held, outside)[1]["release"] == 0.0


def test_a_release_outside_the_goal_costs_1_and_ends_place():
    outside = change(HELD, held=-1, object=[1.0, 0.151, 0.8])
    total, terms = step_reward(Place(), HELD, outside)
    assert (failure(Place(), HELD, outside), terms["release"]) == ("wrong drop", 0.0)
    assert total == close(-1.0 - 0.002)


def test_an_object_that_rolls_out_after_a_right_release_is_no_wrong_drop():
    inside = change(HELD, held=-1, object=[1.0, 0.149, 0.8])
    assert failure(Place(), HELD, inside) == "none"
    assert failure(Place(), HELD, inside, change(inside, object=[1.0, 0.3, 0.8])) == "none"


def test_after_the_release_only_the_way_back_to_rest_counts():
    before = change(HELD, held=-1, object=[1.0, 0.1, 0.8], **gripper_off(0.5))
    total, terms = step_reward(Place(), HELD, before, change(before, object=[1.0, 0.0, 0.8], **gripper_off(0.4)))
    assert terms["retract"] == close(0.4)
    assert total == close(0.4 - 0.002)


def test_success_earns_2_5():
    done = change(HELD, held=-1, object=[1.0, 0.1, 0.8])
    assert step_reward(Place(), HELD, done)[1]["success"] == 2.5


def test_pick_earns_4_per_metre_of_approach_1_for_the_grasp_and_4_per_metre_of_way_back():
    far = state(object=[0.9, 0.0, 1.0])  # 0.4 m before the gripper
    near = change(far, **gripper_off(0.1))
    assert step_reward(Pick(), far, near)[0] == close(4 * 0.1 - 0.002)
    held = change(near, held=BOWL, object=[0.6, 0.0, 1.0])
    assert step_reward(Pick(), far, near, held)[0] == close(1.0 - 0.002)
    back = change(held, **gripper_off(0.06))
    assert step_reward(Pick(), near, held, back)[0] == close(4 * 0.04 - 0.002)


@pytest.mark.parametrize(
    ("end", "label"),
    [({"held": OTHER}, "wrong object"), ({"held_link": DRAWER}, "wrong object")],
)
def test_pick_fails_with_anything_else_in_the_hand(end, label):
    assert failure(Pick(), state(), state(**end)) == label


def test_pick_fails_when_it_drops_the_object():
    assert failure(Pick(), state(), state(held=BOWL), state()) == "dropped"


def test_opening_earns_2_per_metre_of_approach_1_for_the_grasp_2_per_metre_of_joint_and_1_for_letting_go():
    skill, far = OpenDrawer(), state(handle=[0.8, 0.0, 1.0], **gripper_off(0.0))
    near = change(far, **gripper_off(0.1))
    assert step_reward(skill, far, near)[0] == close(2 * 0.1)
    held = change(near, held_link=DRAWER)
    assert step_reward(skill, far, near, held)[0] == close(1.0)
    pulled = change(held, link_position=0.2)
    assert step_reward(skill, near, held, pulled)[0] == close(2 * 0.2)
    beyond = change(held, link_position=0.5)  # as far beyond 0.45 m as 0.4 m is before it
    assert step_reward(skill, held, change(held, link_position=0.4), beyond)[1]["move"] == close(0.0)
    there = change(held, link_position=0.45, **gripper_off(0.3))
    assert step_reward(skill, held, there, change(there, held_link=-1))[0] == close(1.0)
    gone = change(there, held_link=-1)
    assert step_reward(skill, held, there, gone, change(gone, **gripper_off(0.2)))[0] == close(2 * 0.1)


def test_the_fridge_earns_2_per_radian_beyond_the_angle_of_the_stage():
    """The stage needs pi/2 - 0.15 = 1.42 rad; a robot that passes a door there closes it."""
    skill, held = OpenFridge(), state(link_position=1.43, held_link=DRAWER)
    assert [bool(skill.is_accepted(np.array(q))) for q in (1.66, 1.68)] == [False, True]
    moved = [step_reward(skill, held, change(held, link_position=q))[1]["move"] for q in (1.33, 1.53, 1.83)]
    assert moved == pytest.approx([-0.2, 0.2, 0.8])


def test_the_way_to_the_handle_of_an_open_door_leads_around_its_free_edge():
    """The hinge turns to the right: a door at pi/2 of a fridge that faces x faces -y, with its free edge toward x."""
    skill, handle = CloseFridge(), np.array([0.8, 0.0, 1.0])
    for away, way in (((0.0, 0.2), np.hypot(0.2, 0.1) + 0.1), ((0.0, -0.2), 0.2), ((0.3, 1e-12), 0.3)):
        there = state(handle=handle, link_position=np.pi / 2, gripper=handle + np.array([*away, 0.0]))
        assert skill.way_to_handle(there) == close(way)
        assert OpenFridge().way_to_handle(there) == close(np.hypot(*away))


def test_the_free_edge_of_the_doors_way_is_beyond_that_of_the_real_door():
    apartment, q = make_apartment(0, 0), 1.9
    piece, door = apartment.piece_of(FRIDGE_DOOR).pose, apartment.articulation(FRIDGE_DOOR)
    x, _, z = door.handle
    edge = np.array([x, max(solid.center[1] + solid.half[1] for solid in door.solids), z])
    handle, beside = (piece.to_room(door.to_piece(np.asarray(point), q)) for point in (door.handle, edge))
    front = CloseFridge().front(state(front=[np.cos(piece.yaw), np.sin(piece.yaw), 0.0], link_position=q))[0]
    assert 0.05 < (beside - handle) @ [-front[1], front[0], 0.0] < PAST_EDGE


def test_a_drawer_moved_without_holding_its_handle_earns_nothing():
    assert step_reward(CloseDrawer(), state(link_position=0.4), state(link_position=0.2))[1]["move"] == 0.0


@pytest.mark.parametrize(
    ("moments", "label"),
    [
        ([{}, {"held_link": DRAWER + 1}], "wrong grasp"),
        ([{}, {"held": BOWL}], "wrong grasp"),
        ([{}, {"held_link": DRAWER}, {"link_position": 0.2}], "let go early"),
        ([{"held_link": DRAWER, "link_position": 0.45}, {"link_position": 0.45}], "none"),
        ([{"held_link": DRAWER, "link_position": 0.45}, {"link_position": 0.39}], "left the goal"),
    ],
)
def test_opening_fails_by_its_own_rules(moments, label):
    assert failure(OpenDrawer(), *[state(**each) for each in moments]) == label


def test_navigation_earns_1_per_metre_of_way_and_the_last_5_cm_do_not_count():
    assert step_reward(Navigate(), state(way=3.0), state(way=2.9))[0] == close(0.1 - 0.002)
    assert step_reward(Navigate(), state(way=0.06), state(way=0.05))[1]["way"] == close(0.06)
    assert step_reward(Navigate(), state(way=0.05), state(way=0.0))[1]["way"] == 0.0


@pytest.mark.parametrize(
    ("before", "after", "cost"),
    [(0.0, 19.0, 0.0), (0.0, 120.0, 0.12), (30.0, 120.0, 0.09), (120.0, 30.0, 0.0), (0.0, 900.0, 0.2)],
)
def test_a_rise_of_the_contact_force_costs_a_thousandth_per_newton_up_to_a_fifth(before, after, cost):
    terms = step_reward(Pick(), state(contact_force=before), state(contact_force=after))[1]
    assert terms["force"] == close(-cost)


@pytest.mark.parametrize(("skill", "limit"), [(Pick(), 5000), (Place(), 7500)])
def test_rises_of_the_force_are_summed_up_to_the_limit(skill, limit):
    hits = [state(contact_force=0.0), state(contact_force=float(limit) / 2.0)]
    assert failure(skill, *hits, *hits) == "none"
    assert failure(skill, *hits, *hits, *[state(), state(contact_force=21.0)]) == "excess force"


@pytest.mark.parametrize(("what", "limit"), [({"held": BOWL}, 0.09), ({"held_link": DRAWER}, 0.2)])
def test_a_grasp_torn_too_far_is_invalid(what, limit):
    skill = Pick() if "held" in what else OpenDrawer()
    assert failure(skill, state(**what, hold_error=limit - 0.001)) == "none"
    assert failure(skill, state(**what, hold_error=limit + 0.001)) == "invalid grasp"


def test_pick_cannot_let_go_place_cannot_grasp_and_navigation_moves_the_base_only():
    actions, now = np.array([np.linspace(-0.9, 0.9, 11), np.linspace(0.9, -0.9, 11)]), random_state(2, 0)
    actions[:, ROBOT.action.grip] = 0.9, -0.9
    alone = replace(now, neighbor_distance=np.full(2, np.inf), handle_distance=np.full(2, np.inf))
    assert Pick().mask(actions, alone)[:, ROBOT.action.grip].tolist() == [0.9, 0.0]
    assert Place().mask(actions, now)[:, ROBOT.action.grip].tolist() == [0.0, -0.9]
    masked = Navigate().mask(actions, now)
    assert not masked[:, ROBOT.action.arm].any()
    assert not masked[:, ROBOT.action.grip].any()
    np.testing.assert_array_equal(masked[:, :2], actions[:, :2])
    np.testing.assert_array_equal(OpenDrawer().mask(actions, now), actions)


@pytest.mark.parametrize(
    ("around", "closes"),
    [
        ({"neighbor_distance": 0.101}, True),
        ({"neighbor_distance": 0.099}, False),
        ({"handle_distance": 0.151}, True),
        ({"handle_distance": 0.149}, False),  # the magic grasp prefers handles, however near the object is
    ],
)
def test_pick_closes_its_hand_only_where_it_would_take_the_target(around, closes):
    action = np.zeros((1, 11))
    action[:, ROBOT.action.grip] = 0.5
    now = state(gripper=[1.0, 0.0, 0.8], object=[1.1, 0.0, 0.8], **around)
    assert bool(Pick().mask(action, now)[0, ROBOT.action.grip] > 0.0) == closes


def test_reset_arm_moves_a_joint_to_rest_by_at_most_a_tenth_of_a_radian_and_rolls_the_short_way():
    target = ROBOT.rest_arm.copy()
    target[0] += 0.05
    target[1] -= 0.5
    target[2] += 2.0 * np.pi - 0.04  # 0.04 below, once round
    action = ResetArm().act(state(arm_target=target))[0]
    np.testing.assert_allclose(action[ROBOT.action.arm], [-0.5, 1.0, 0.4, 0.0, 0.0, 0.0, 0.0], atol=1e-9)


NAMES = ("pick", "place", "open_drawer", "close_drawer", "open_fridge", "close_fridge", "navigate", "reset_arm")


@pytest.mark.parametrize("skill", [*map(get_skill, NAMES), Place(delta=30)], ids=[*NAMES, "place for 30 steps"])
class TestEverySkill:
    def test_has_as_many_elements_as_numbers_and_each_by_its_own_name(self, skill):
        now = random_state(3, 1)
        assert skill.observe(now, skill.begin(now)).shape == (3, len(skill.elements))
        assert len({each.name for each in skill.elements}) == len(skill.elements)

    def test_sees_a_lane_alone_as_it_sees_it_among_others_to_the_last_bit(self, skill):
        before, after = random_state(17, 2), random_state(17, 3)
        was = skill.begin(before)
        now = skill.advance(was, after)
        many = [skill.observe(after, now), *_judged(skill, before, after, was, now)]
        for lane in range(17):
            row = slice(lane, lane + 1)
            was_one = skill.begin(before[row])
            now_one = skill.advance(was_one, after[row])
            one = [skill.observe(after[row], now_one), *_judged(skill, before[row], after[row], was_one, now_one)]
            for everyone, alone in zip(many, one, strict=True):
                np.testing.assert_array_equal(everyone[row], alone)

    def test_earns_the_sum_of_its_terms(self, skill):
        before, after = random_state(17, 4), random_state(17, 5)
        was = skill.begin(before)
        total, terms = skill.reward(before, after, was, skill.advance(was, after))
        np.testing.assert_allclose(total, np.sum(list(terms.values()), axis=0), atol=1e-12)


def _judged(skill, before, after, was, now):
    total, terms = skill.reward(before, after, was, now)
    judged = skill.success(after, now), skill.stop(after, now), skill.failure(after, now)
    return [total, *terms.values(), *judged]


def test_what_is_seen_is_relative_to_a_turned_robot():
    """The robot at (1, 2) faces north; the goal is 1 m north and 2 m west of it: 1 m ahead, 2 m to the left."""
    now = state(base=[1.0, 2.0, np.pi / 2.0], goal=[-1.0, 3.0, 0.8], object=[-1.0, 3.5, 0.8], gripper=[1.0, 2.5, 1.0])
    skill = Place()
    seen = dict(zip([each.name for each in skill.elements], skill.observe(now, skill.begin(now))[0], strict=True))
    assert [seen[f"goal_in_base_{a}"] for a in "xyz"] == close([1.0, 2.0, 0.8])
    assert [seen[f"goal_from_gripper_{a}"] for a in "xyz"] == close([0.5, 2.0, -0.2])
    assert [seen[f"object_from_goal_{a}"] for a in "xyz"] == close([0.5, 0.0, 0.0])
    assert seen["goal_distance"] == close(0.5)
