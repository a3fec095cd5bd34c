"""Inverse kinematics: what it must find, what it must admit."""

import threading

import numpy as np
import pytest

from perdure.errors import PerdureError
from perdure.home.sim.kinematics import damped_inverse, damped_step, gripper_pose, pose_and_jacobian, reach, reach_many
from perdure.home.sim.robot import ARM_HIGH, ARM_LOW, REST_ARM, REST_POSITION

M3_INITIAL = (-0.268, -1.133, 0.367, 1.081, 0.06, 2.002, 0.067)


def angle(first, second):
    return np.arccos(np.clip(0.5 * (np.trace(first.T @ second) - 1.0), -1.0, 1.0))


def test_poses_of_random_arms_are_found(random_arms):
    """Poses made by forward kinematics can be reached; starts are far away, so a few may be missed."""
    missed = 0
    for arm in random_arms[:40]:
        position, rotation = gripper_pose(0.15, arm)
        found = reach(position, REST_ARM, rotation=rotation)
        now = gripper_pose(0.15, found.arm)
        assert np.linalg.norm(now[0] - position) == pytest.approx(found.position_error, abs=1e-9)
        assert angle(now[1], rotation) == pytest.approx(found.rotation_error, abs=1e-6)
        assert np.all(found.arm >= np.array(ARM_LOW) - 1e-9)
        assert np.all(found.arm <= np.array(ARM_HIGH) + 1e-9)
        missed += not found.ok
    assert missed <= 2


def test_nearby_poses_are_found_at_once_and_near(random_arms):
    rng = np.random.default_rng(1)
    for _ in range(40):
        arm = np.clip(REST_ARM + rng.normal(0.0, 0.1, 7), ARM_LOW, ARM_HIGH)
        position, rotation = gripper_pose(0.15, arm)
        found = reach(position, REST_ARM, rotation=rotation, restarts=0)
        assert found.ok
        assert np.abs(found.arm - REST_ARM).max() < 1.0


def test_only_the_direction_of_the_fingers_is_asked_for(random_arms):
    missed = 0
    for arm in random_arms[40:60]:
        position, rotation = gripper_pose(0.15, arm)
        found = reach(position, REST_ARM, approach=3.0 * rotation[:, 0])
        got = gripper_pose(0.15, found.arm)
        if found.ok:
            assert got[0] == pytest.approx(position, abs=2e-4)
            assert got[1][:, 0] == pytest.approx(rotation[:, 0], abs=2e-3)
        missed += not found.ok
    assert missed <= 2


def test_an_opposite_approach_direction_is_no_trap():
    start = reach((0.6, 0.0, 0.9), REST_ARM, approach=(1.0, 0.0, 0.0)).arm
    found = reach((0.6, 0.0, 0.9), start, approach=-gripper_pose(0.15, start)[1][:, 0])
    assert np.isfinite(found.arm).all()
    assert found.position_error < 0.5


def test_a_place_alone_leaves_the_hand_as_it_was():
    found = reach((0.55, 0.05, 0.95), REST_ARM)
    assert found.ok
    assert found.rotation_error == 0.0
    assert angle(gripper_pose(0.15, found.arm)[1], gripper_pose(0.15, REST_ARM)[1]) < 0.5


def test_rest_is_found_from_m3s_initial_pose_with_its_approach():
    approach = gripper_pose(0.15, M3_INITIAL)[1]
    found = reach(REST_POSITION, M3_INITIAL, rotation=approach)
    assert found.arm == pytest.approx(REST_ARM, abs=1e-4)


@pytest.mark.parametrize("place", [(3.0, 0.0, 1.0), (0.5, 0.0, -1.0), (-0.9, 0.0, 0.3)])
def test_places_out_of_reach_are_reported_and_not_raised(place):
    found = reach(place, REST_ARM, rotation=np.eye(3))
    assert not found.ok
    assert found.position_error + found.rotation_error > 0.05
    assert np.isfinite(found.arm).all()
    shoulder = np.array([0.14965, 0.0, 0.93601])  # the arm can do no better than stretch towards it
    distance = np.linalg.norm(np.array(place) - gripper_pose(0.15, found.arm)[0])
    assert distance >= np.linalg.norm(place - shoulder) - 0.97845 - 0.117


def test_a_far_place_stretches_the_arm_towards_it():
    """The farthest point along x is the gripper point of the straight arm, 1 cm before its link: 1.118 m."""
    found = reach((3.0, 0.0, 0.934), REST_ARM)
    assert found.position_error == pytest.approx(3.0 - 1.118, abs=0.01)


@pytest.mark.parametrize("torso", [0.0, 0.15, 0.386])
def test_the_torsos_height_counts(torso):
    found = reach((0.6, 0.1, 0.9), REST_ARM, torso=torso)
    assert found.ok
    assert gripper_pose(torso, found.arm)[0] == pytest.approx((0.6, 0.1, 0.9), abs=2e-4)


def test_answers_do_not_depend_on_earlier_questions_or_on_the_thread():
    first = reach((0.6, 0.1, 0.9), REST_ARM).arm
    reach((2.0, 0.0, 0.0), REST_ARM, torso=0.3)
    answers = [reach((0.6, 0.1, 0.9), REST_ARM).arm]
    threads = [threading.Thread(target=lambda: answers.append(reach((0.6, 0.1, 0.9), REST_ARM).arm)) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(answers) == 4
    for answer in answers:
        assert np.array_equal(answer, first)


def test_a_start_beyond_the_limits_is_brought_back():
    found = reach(REST_POSITION, np.full(7, 3.0), restarts=0)
    assert np.all(found.arm <= np.array(ARM_HIGH) + 1e-9)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"position": (1.0, 2.0)}, "position must be finite numbers of shape"),
        ({"position": (np.nan, 0.0, 0.0)}, "position must be finite"),
        ({"start_arm": np.zeros(6)}, "start_arm must be finite numbers of shape"),
        ({"rotation": np.eye(4)}, "rotation must be finite numbers of shape"),
        ({"approach": (0.0, 0.0, 0.0)}, "approach must have a direction"),
        ({"rotation": np.eye(3), "approach": (1.0, 0.0, 0.0)}, "not both"),
    ],
)
def test_wrong_questions_are_refused(arguments, message):
    with pytest.raises(PerdureError, match=message):
        reach(**({"position": REST_POSITION, "start_arm": REST_ARM} | arguments))


def test_many_poses_made_by_forward_kinematics_are_found():
    rng = np.random.default_rng(1)
    arm = np.clip(np.array(REST_ARM) + rng.uniform(-0.5, 0.5, (40, 7)), ARM_LOW, ARM_HIGH)
    points, rotation = gripper_pose(0.15, arm)
    found, way, turn = reach_many(points, rotation[:, :, 0], False, np.array(REST_ARM))
    position, axes = gripper_pose(0.15, found)
    assert np.allclose(np.linalg.norm(points - position, axis=1), way, atol=1e-9)
    good = (way < 0.01) & (turn < 0.05)
    assert good.mean() > 0.9
    assert ((axes[:, :, 0] * rotation[:, :, 0]).sum(axis=1)[good] > 0.99).all()


def test_a_point_out_of_reach_is_reported_by_its_distance():
    _, way, _ = reach_many(np.array([[3.0, 0.0, 1.0]]), np.array([[1.0, 0.0, 0.0]]), False, np.array(REST_ARM))
    assert way[0] > 1.0


@pytest.mark.parametrize(("sign", "angle"), [(-1.0, np.pi), (1.0, 0.0)])
def test_an_opposite_direction_is_half_a_turn_away(sign, angle):
    """The axis of half a turn is lost in a cross product; the angle must not be."""
    position, rotation = gripper_pose(0.15, REST_ARM)
    _, _, turn = reach_many(position[None], sign * rotation[None, :, 0], False, np.array(REST_ARM), iterations=0)
    assert turn[0] == pytest.approx(angle, abs=1e-6)


def test_a_damped_inverse_is_that_of_the_extended_least_squares_problem():
    """min |J q - e|^2 + d^2 |q|^2, solved by stacking."""
    matrix, error, damping = pose_and_jacobian(0.15, REST_ARM)[2][:3], np.array([0.01, -0.02, 0.03]), 0.03
    stacked, wanted = np.vstack([matrix, damping * np.eye(7)]), np.concatenate([error, np.zeros(7)])
    expected = np.linalg.lstsq(stacked, wanted, rcond=None)[0]
    assert damped_inverse(matrix, damping) @ error == pytest.approx(expected, abs=1e-12)
    assert damped_step(matrix, error, damping) == pytest.approx(expected, abs=1e-12)
    assert np.linalg.pinv(matrix) @ error != pytest.approx(expected, abs=1e-6)
