"""What a place policy's action does to the robot: joints, the hand, and what counts as 0."""

from dataclasses import replace

import numpy as np
import pytest
from hand_made import random_state

from perdure.home.sim.kinematics import gripper_pose
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.simulator import ARM_STEP
from perdure.home.skills.place import HAND_STEP, Place


def at_rest():
    return replace(random_state(1, 0), arm_target=np.array([ROBOT.rest_arm]))


def test_small_actions_are_0_for_a_gentle_release_and_full_ones_stay():
    actions = np.array([[0.15, -0.1, 1.0, -1.0, 0.575, 0.0, 0.0, 0.0, 0.0, -0.05]])
    moved = Place(gentle=True).expand_action(actions, at_rest())[0]
    assert moved[:5] == pytest.approx([0.0, 0.0, 1.0, -1.0, 0.5])
    assert moved[ROBOT.action.grip] == -0.05
    assert np.array_equal(Place().expand_action(actions, at_rest())[0, :10], actions[0])


@pytest.mark.parametrize("way", [(0.3, 0.0, 0.0), (0.0, -0.5, 0.0), (0.0, 0.0, -0.5)])
def test_an_action_of_the_hand_moves_it_along_the_bases_axes_and_keeps_its_rotation(way):
    skill = Place(actions="hand")
    moved = skill.expand_action(np.array([[0.3, 0.0, *way, -1.0]]), at_rest())[0]
    before, after = (
        gripper_pose(ROBOT.torso_height, ROBOT.rest_arm + k * ARM_STEP * moved[ROBOT.action.arm]) for k in (0, 1)
    )
    assert after[0] - before[0] == pytest.approx(HAND_STEP * np.array(way), abs=1e-4)
    assert after[1] == pytest.approx(before[1], abs=1e-3)
    assert (skill.action_size, moved[0], moved[ROBOT.action.grip]) == (6, 0.3, -1.0)


@pytest.mark.parametrize("way", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0)])
def test_a_full_action_of_the_hand_is_shorter_but_keeps_its_direction(way):
    moved = Place(actions="hand").expand_action(np.array([[0.0, 0.0, *way, -1.0]]), at_rest())[0]
    assert np.abs(moved[ROBOT.action.arm]).max() == pytest.approx(1.0)
    before, after = (
        gripper_pose(ROBOT.torso_height, ROBOT.rest_arm + k * ARM_STEP * moved[ROBOT.action.arm])[0] for k in (0, 1)
    )
    length = np.linalg.norm(after - before)
    assert 0.005 < length < HAND_STEP
    assert (after - before) @ way == pytest.approx(length, rel=0.01)


def test_a_hand_that_is_not_moved_rests():
    moved = Place(actions="hand").expand_action(np.zeros((1, 6)), at_rest())[0]
    assert np.array_equal(moved, np.zeros(11))
