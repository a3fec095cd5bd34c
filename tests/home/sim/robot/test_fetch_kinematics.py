"""Forward kinematics against homogeneous transforms typed from the URDF, published poses and MuJoCo."""

import math

import mujoco
import numpy as np
import pytest
from fetch_scenes import set_pose
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from perdure.errors import PerdureError
from perdure.home.sim.kinematics import gripper_pose, pose_and_jacobian
from perdure.home.sim.robot import ROBOT

M3_INITIAL = (-0.268, -1.133, 0.367, 1.081, 0.06, 2.002, 0.067)
LAB_INITIAL = (-0.45, -1.08, 0.1, 0.935, -0.001, 1.573, 0.005)
URDF = [  # xyz of the joint, its axis
    ((0.119525, 0, 0.34858), "z"),
    ((0.117, 0, 0.06), "y"),
    ((0.219, 0, 0), "x"),
    ((0.133, 0, 0), "y"),
    ((0.197, 0, 0), "x"),
    ((0.1245, 0, 0), "y"),
    ((0.1385, 0, 0), "x"),
]


def shift(x, y, z):
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def turn(axis, angle):
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler(axis, angle).as_matrix()
    return matrix


def gripper_link(torso, arm):
    """Base frame to `gripper_link` as one product of 4 x 4 matrices."""
    frame = shift(-0.086875, 0, 0.37743) @ shift(0, 0, torso)
    for (xyz, axis), angle in zip(URDF, arm, strict=True):
        frame = frame @ shift(*xyz) @ turn(axis, angle)
    return frame @ shift(0.16645, 0, 0)


def link_of(position, rotation):
    """`gripper_link` from the gripper point: M3's point is (-0.01, -0.0001, -0.0017) in its frame."""
    return position + rotation @ [0.01, 0.0001, 0.0017]


@pytest.mark.parametrize(
    ("arm", "published"),
    [(np.zeros(7), (1.128, 0.0, 0.936)), (M3_INITIAL, (0.5, 0.0, 1.0)), (LAB_INITIAL, (0.630, -0.240, 0.992))],
)
def test_published_poses_of_the_gripper_link(arm, published):
    assert link_of(*gripper_pose(0.15, arm)) == pytest.approx(published, abs=6e-4)


def test_a_wrong_angle_misses_the_published_pose():
    arm = np.array(M3_INITIAL)
    arm[3] += 0.01
    assert np.linalg.norm(link_of(*gripper_pose(0.15, arm)) - (0.5, 0.0, 1.0)) > 3e-3


def test_reach_from_the_shoulder_lift_is_the_published_one():
    position, rotation = gripper_pose(0.0, np.zeros(7))
    shoulder = np.array([-0.086875 + 0.119525 + 0.117, 0.0, 0.37743 + 0.34858 + 0.06])
    assert np.linalg.norm(link_of(position, rotation) - shoulder) == pytest.approx(0.97845, abs=1e-9)


def test_poses_equal_the_product_of_urdf_transforms(random_arms):
    torso = np.linspace(0.0, 0.38615, len(random_arms))
    position, rotation = gripper_pose(torso, random_arms)
    for i, arm in enumerate(random_arms):
        expected = gripper_link(torso[i], arm)
        assert rotation[i] == pytest.approx(expected[:3, :3], abs=1e-12)
        assert link_of(position[i], rotation[i]) == pytest.approx(expected[:3, 3], abs=1e-12)


def test_poses_equal_the_site_of_the_model(data, random_arms):
    for arm in random_arms[:50]:
        set_pose(data, arm, torso=0.2)
        position, rotation = gripper_pose(0.2, arm)
        assert data.site("gripper").xpos == pytest.approx(position, abs=1e-9)
        assert data.site("gripper").xmat.reshape(3, 3) == pytest.approx(rotation, abs=1e-9)


def test_the_model_carries_the_gripper_along_with_its_base(data):
    set_pose(data, base=(2.0, -1.0, math.pi / 2))
    x, y, z = ROBOT.rest_position
    assert data.site("gripper").xpos == pytest.approx((2.0 - y, -1.0 + x, z), abs=1e-5)


def test_rest_is_the_resting_position_with_the_fingers_pointing_as_in_m3():
    position, rotation = gripper_pose(0.15, ROBOT.rest_arm)
    assert position == pytest.approx(ROBOT.rest_position, abs=1e-6)
    assert rotation[:, 0] == pytest.approx((-0.36, 0.17, -0.92), abs=0.005)
    assert pytest.approx(M3_INITIAL, abs=0.05) == ROBOT.rest_arm


def test_batches_equal_single_arms(random_arms):
    lanes = random_arms[:12].reshape(3, 4, 7)
    torso = np.linspace(0.0, 0.3, 4)
    position, rotation, columns = pose_and_jacobian(torso, lanes)
    assert (position.shape, rotation.shape, columns.shape) == ((3, 4, 3), (3, 4, 3, 3), (3, 4, 6, 7))
    for i, j in np.ndindex(3, 4):
        one = pose_and_jacobian(torso[j], lanes[i, j])
        for batch, single in zip((position, rotation, columns), one, strict=True):
            assert batch[i, j] == pytest.approx(single, abs=1e-14)


def test_one_arm_at_many_heights_is_a_batch():
    position, _ = gripper_pose([0.0, 0.1, 0.3], ROBOT.rest_arm)
    assert np.diff(position[:, 2]) == pytest.approx([0.1, 0.2])


@given(st.lists(st.floats(-1.5, 1.5), min_size=7, max_size=7))
def test_jacobian_equals_finite_differences(arm):
    arm, small = np.array(arm), 1e-6
    columns = pose_and_jacobian(0.15, arm)[2]
    for i, unit in enumerate(np.eye(7)):
        ahead, behind = gripper_pose(0.15, arm + small * unit), gripper_pose(0.15, arm - small * unit)
        turned = Rotation.from_matrix(ahead[1] @ behind[1].T).as_rotvec()
        assert columns[:3, i] == pytest.approx((ahead[0] - behind[0]) / (2 * small), abs=1e-8)
        assert columns[3:, i] == pytest.approx(turned / (2 * small), abs=1e-8)


def test_jacobian_equals_mujocos(model, data):
    set_pose(data)
    position, rotation = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, data, position, rotation, model.site("gripper").id)
    assert pose_and_jacobian(0.15, ROBOT.rest_arm)[2] == pytest.approx(
        np.vstack([position, rotation])[:, 4:11], abs=1e-12
    )


@pytest.mark.parametrize("shape", [(6,), (3, 8), ()])
def test_arms_of_a_wrong_shape_are_refused(shape):
    with pytest.raises(PerdureError, match=r"arm angles must have shape \(\.\.\., 7\)"):
        gripper_pose(0.15, np.zeros(shape))
