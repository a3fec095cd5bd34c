"""Inverse kinematics: what it must find, what it must admit."""

import numpy as np
import pytest

from perdure.home.sim.kinematics import damped_inverse, damped_step, gripper_pose, pose_and_jacobian, reach, reach_many
from perdure.home.sim.robot import ROBOT

M3_INITIAL = (-0.268, -1.133, 0.367, 1.081, 0.06, 2.002, 0.067)


def angle(first, second):
    return np.arccos(np.clip(0.5 * (np.trace(first.T @ second) - 1.0), -1.0, 1.0))


def test_poses_of_random_arms_are_found(random_arms):
    """Poses made by forward kinematics can be reached; the start is far away, so some are missed."""
    missed = 0
    for arm in random_arms[:40]:
        position, rotation = gripper_pose(0.15, arm)
        found, way, turn = reach(position, rotation, 0.5 * (arm + ROBOT.rest_arm))
        now = gripper_pose(0.15, found)
        assert np.linalg.norm(now[0] - position) == pytest.approx(way, abs=1e-9)
        assert angle(now[1], rotation) == pytest.approx(turn, abs=1e-6)
        assert np.all(found >= ROBOT.arm_low - 1e-9)
        assert np.all(found <= ROBOT.arm_high + 1e-9)
        missed += way > 1e-4 or turn > 1e-3
    assert missed <= 8


def test_nearby_poses_are_found_near():
    rng = np.random.default_rng(1)
    for _ in range(40):
        arm = np.clip(ROBOT.rest_arm + rng.normal(0.0, 0.1, 7), ROBOT.arm_low, ROBOT.arm_high)
        found, way, turn = reach(*gripper_pose(0.15, arm), ROBOT.rest_arm)
        assert (way < 1e-4, turn < 1e-3) == (True, True)
        assert np.abs(found - ROBOT.rest_arm).max() < 1.0


def test_rest_is_found_from_m3s_initial_pose_with_its_approach():
    found, *_ = reach(ROBOT.rest_position, gripper_pose(0.15, M3_INITIAL)[1], np.array(M3_INITIAL))
    assert found == pytest.approx(ROBOT.rest_arm, abs=1e-4)


@pytest.mark.parametrize("place", [(3.0, 0.0, 1.0), (0.5, 0.0, -1.0), (-0.9, 0.0, 0.3)])
def test_places_out_of_reach_are_reported_and_not_raised(place):
    """The arm can do no better than stretch from its shoulder towards the place."""
    found, way, turn = reach(np.array(place), np.eye(3), ROBOT.rest_arm)
    assert way + turn > 0.05
    distance = np.linalg.norm(np.array(place) - gripper_pose(0.15, found)[0])
    assert distance >= np.linalg.norm(place - np.array([0.14965, 0.0, 0.93601])) - 0.97845 - 0.117


def test_a_start_beyond_the_limits_is_brought_back():
    found, *_ = reach(ROBOT.rest_position, np.eye(3), np.full(7, 3.0))
    assert np.all(found <= ROBOT.arm_high + 1e-9)


def test_many_poses_made_by_forward_kinematics_are_found():
    rng = np.random.default_rng(1)
    arm = np.clip(ROBOT.rest_arm + rng.uniform(-0.5, 0.5, (40, 7)), ROBOT.arm_low, ROBOT.arm_high)
    points, rotation = gripper_pose(0.15, arm)
    found, way, turn = reach_many(points, rotation[:, :, 0], None, ROBOT.rest_arm)
    position, axes = gripper_pose(0.15, found)
    assert np.allclose(np.linalg.norm(points - position, axis=1), way, atol=1e-9)
    good = (way < 0.01) & (turn < 0.05)
    assert good.mean() > 0.9
    assert ((axes[:, :, 0] * rotation[:, :, 0]).sum(axis=1)[good] > 0.99).all()


def test_a_point_out_of_reach_is_reported_by_its_distance():
    _, way, _ = reach_many(np.array([[3.0, 0.0, 1.0]]), np.array([[1.0, 0.0, 0.0]]), None, ROBOT.rest_arm)
    assert way[0] > 1.0


@pytest.mark.parametrize(("sign", "angle"), [(-1.0, np.pi), (1.0, 0.0)])
def test_an_opposite_direction_is_half_a_turn_away(sign, angle):
    """The axis of half a turn is lost in a cross product; the angle must not be."""
    position, rotation = gripper_pose(0.15, ROBOT.rest_arm)
    _, _, turn = reach_many(position[None], sign * rotation[None, :, 0], None, ROBOT.rest_arm, iterations=0)
    assert turn[0] == pytest.approx(angle, abs=1e-6)


def test_a_damped_inverse_is_that_of_the_extended_least_squares_problem():
    """min |J q - e|^2 + d^2 |q|^2, solved by stacking."""
    matrix, error, damping = pose_and_jacobian(0.15, ROBOT.rest_arm)[2][:3], np.array([0.01, -0.02, 0.03]), 0.03
    stacked, wanted = np.vstack([matrix, damping * np.eye(7)]), np.concatenate([error, np.zeros(7)])
    expected = np.linalg.lstsq(stacked, wanted, rcond=None)[0]
    assert damped_inverse(matrix, damping) @ error == pytest.approx(expected, abs=1e-12)
    assert damped_step(matrix, error, damping) == pytest.approx(expected, abs=1e-12)
    assert np.linalg.pinv(matrix) @ error != pytest.approx(expected, abs=1e-6)
