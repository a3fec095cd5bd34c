"""Straight steps of the gripper."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear
from scipy.spatial.transform import Rotation

from perdure.errors import PerdureError
from perdure.home.sim.kinematics import gripper_pose, pose_and_jacobian, rotation_vector, toward
from perdure.home.sim.robot import ROBOT


def drive(goals, steps=150, **options):
    """Walks lanes from rest to their goals, 1 cm a step. Returns arms, and how far each left its straight line."""
    arms = np.tile(ROBOT.rest_arm, (len(goals), 1))
    start, rotation = gripper_pose(0.15, arms)
    line = (goals - start) / np.linalg.norm(goals - start, axis=1, keepdims=True)
    strayed = np.zeros(len(goals))
    for _ in range(steps):
        now, _ = gripper_pose(0.15, arms)
        left = goals - now
        arms = arms + toward(
            arms,
            left * np.minimum(1.0, 0.01 / np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-9)),
            **options,
        )
        away = gripper_pose(0.15, arms)[0] - start
        strayed = np.maximum(strayed, np.linalg.norm(away - line * np.sum(away * line, axis=1, keepdims=True), axis=1))
    return arms, strayed, rotation


def test_gripper_goes_down_in_a_straight_line_and_keeps_its_rotation():
    goals = np.array([[0.5, 0.0, 0.8], [0.55, 0.1, 0.75], [0.5, -0.1, 0.9], [0.4, 0.0, 0.85]])
    _, first = gripper_pose(0.15, ROBOT.rest_arm)
    arms, strayed, _ = drive(goals, rotation=first)
    position, rotation = gripper_pose(0.15, arms)
    assert position == pytest.approx(goals, abs=1e-3)
    assert np.linalg.norm(rotation_vector(rotation, first), axis=1).max() < 0.005
    assert strayed.max() < 0.005


def test_without_a_wanted_rotation_the_present_one_drifts_little():
    arms, _, rotation = drive(np.array([[0.5, 0.0, 0.8]]))
    assert np.linalg.norm(rotation_vector(gripper_pose(0.15, arms)[1], rotation)) < 0.05


def test_gripper_turns_to_a_wanted_rotation_on_the_spot():
    position, rotation = gripper_pose(0.15, ROBOT.rest_arm)
    wanted = Rotation.from_rotvec([0.1, -0.3, 0.2]).as_matrix() @ rotation
    arm = ROBOT.rest_arm.copy()
    for _ in range(60):
        arm = arm + toward(arm, position - gripper_pose(0.15, arm)[0], rotation=wanted)
    now = gripper_pose(0.15, arm)
    assert now[0] == pytest.approx(position, abs=1e-3)
    assert np.linalg.norm(rotation_vector(now[1], wanted)) < 0.01


def test_one_small_step_moves_the_gripper_by_what_was_asked():
    move = np.array([1e-4, -2e-4, 1.5e-4])
    before, turned = gripper_pose(0.15, ROBOT.rest_arm)
    after, still = gripper_pose(0.15, ROBOT.rest_arm + toward(ROBOT.rest_arm, move))
    assert after - before == pytest.approx(move, abs=1e-5)
    assert np.linalg.norm(rotation_vector(turned, still)) < 1e-4


@settings(deadline=None)
@given(
    st.lists(st.floats(0.0, 1.0), min_size=7, max_size=7),
    st.lists(st.floats(-0.5, 0.5), min_size=3, max_size=3),
    st.floats(1e-3, 0.5),
)
def test_steps_are_bounded_and_keep_the_limits(shares, move, largest):
    low, high = np.clip(ROBOT.arm_low, -3.0, 3.0), np.clip(ROBOT.arm_high, -3.0, 3.0)
    arm = low + np.array(shares) * (high - low)
    step = toward(arm, move, largest=largest)
    assert np.abs(step).max() <= largest * (1 + 1e-12)
    assert np.all(arm + step >= ROBOT.arm_low - 1e-9)
    assert np.all(arm + step <= ROBOT.arm_high + 1e-9)


def test_a_joint_at_its_limit_is_passed_by_the_others():
    """The wrist stands at its stop: steps are as good as SciPy's best within the limits; clipped free ones are not."""
    arm = ROBOT.rest_arm.copy()
    arm[5] = 2.16
    low, high = ROBOT.arm_low - arm - 1e-9, ROBOT.arm_high - arm + 1e-9
    weighted = np.diag([1.0, 1.0, 1.0, 0.3, 0.3, 0.3]) @ pose_and_jacobian(0.15, arm)[2]
    problem = np.vstack([weighted, 0.01 * np.eye(7)])  # the error, and 1 cm for each radian of a joint
    gained = []
    for direction in np.vstack([np.eye(3), -np.eye(3)]):
        wanted = np.append(0.004 * direction, np.zeros(10))
        step = toward(arm, 0.004 * direction, largest=1.0)
        assert step[5] <= 1e-12
        best = lsq_linear(problem, wanted, (low, high)).x
        clipped = np.clip(np.linalg.lstsq(problem, wanted)[0], low, high)
        costs = [np.linalg.norm(problem @ x - wanted) for x in (step, best, clipped)]
        assert costs[0] == pytest.approx(costs[1], rel=1e-3, abs=1e-7)
        gained.append(costs[2] - costs[0])
    assert max(gained) > 1e-3


def test_lanes_do_not_disturb_each_other(random_arms):
    rng = np.random.default_rng(0)
    arms, moves = random_arms[:30], rng.normal(0.0, 0.02, (30, 3))
    rotation = gripper_pose(0.15, ROBOT.rest_arm)[1]
    together = toward(arms, moves, rotation=rotation)
    for i in range(30):
        assert together[i] == pytest.approx(toward(arms[i], moves[i], rotation=rotation), abs=1e-12)


@given(st.lists(st.floats(-1.7, 1.7), min_size=3, max_size=3))
def test_rotation_vectors_equal_scipys(vector):
    start = Rotation.from_rotvec([0.3, -0.2, 0.9])
    end = Rotation.from_rotvec(vector) * start
    assert rotation_vector(start.as_matrix(), end.as_matrix()) == pytest.approx(np.array(vector), abs=1e-7)


def test_wrong_steps_are_refused():
    with pytest.raises(PerdureError, match="displacement must have shape"):
        toward(ROBOT.rest_arm, (0.0, 0.0))
    with pytest.raises(PerdureError, match="largest must be positive"):
        toward(ROBOT.rest_arm, (0.0, 0.0, 0.0), largest=0.0)
