"""The Fetch's model against the URDF's own numbers, typed here once more."""

import subprocess
import sys

import mujoco
import numpy as np
import pytest
from fetch_scenes import make_spec, set_pose, touching

from perdure.home.sim.apartments import build_apartment, make_apartment
from perdure.home.sim.robot import ROBOT, add_fetch

ORDER = [
    "base_x",
    "base_y",
    "base_yaw",
    "torso_lift_joint",
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "upperarm_roll_joint",
    "elbow_flex_joint",
    "forearm_roll_joint",
    "wrist_flex_joint",
    "wrist_roll_joint",
    "l_gripper_finger_joint",
    "r_gripper_finger_joint",
]
LIMITS = {
    "torso_lift_joint": (0, 0.38615),
    "shoulder_pan_joint": (-1.6056, 1.6056),
    "shoulder_lift_joint": (-1.221, 1.518),
    "elbow_flex_joint": (-2.251, 2.251),
    "wrist_flex_joint": (-2.16, 2.16),
    "l_gripper_finger_joint": (0, 0.05),
    "r_gripper_finger_joint": (0, 0.05),
}
MASSES = {
    "robot": 70.1294 + 2 * 4.3542 + 13.2775,
    "torso_lift_link": 10.7796 + 2.2556 + 0.9087,
    "shoulder_pan_link": 2.5587,
    "shoulder_lift_link": 2.6615,
    "upperarm_roll_link": 2.3311,
    "elbow_flex_link": 2.1299,
    "forearm_roll_link": 1.6563,
    "wrist_flex_link": 1.7250,
    "wrist_roll_link": 0.1354,
    "gripper_link": 1.5175,
    "l_gripper_finger_link": 0.0798,
    "r_gripper_finger_link": 0.0798,
}
EFFORTS = [450, 200, 131.76, 76.94, 66.18, 29.35, 25.7, 7.36, 60, 60]


def test_joints_and_actuators_have_the_agreed_names_and_order(model):
    assert [model.joint(i).name for i in range(model.njnt)] == ORDER
    assert [model.actuator(i).name for i in range(model.nu)] == ["base_forward", "base_left", "base_turn", *ORDER[3:]]
    assert [model.actuator(i).trnid[0] for i in range(3, model.nu)] == list(range(3, 13))
    assert {model.site(model.actuator(i).trnid[0]).name for i in range(3)} == {"base"}
    assert list(ROBOT.joint_names) == ORDER


@pytest.mark.parametrize("degree", [True, False])
def test_limits_are_the_urdfs_whatever_unit_the_specification_uses(degree):
    spec = make_spec()
    spec.compiler.degree = degree
    add_fetch(spec, visuals=False)
    model = spec.compile()
    for name in ORDER:
        limited, (low, high) = model.joint(name).limited[0], LIMITS.get(name, (0, 0))
        assert bool(limited) == (name in LIMITS), name
        if limited:
            assert model.joint(name).range == pytest.approx((low, high)), name
            assert model.actuator(name).ctrlrange == pytest.approx((low, high)), name


def test_the_published_limits_are_those_of_the_model():
    for name, low, high in zip(ROBOT.arm_names, ROBOT.arm_low, ROBOT.arm_high, strict=True):
        assert (low, high) == LIMITS.get(name, (-np.inf, np.inf))


def test_the_record_of_the_robot_is_what_mujoco_reads_from_the_same_file(model, data):
    for number, joint in enumerate(ROBOT.joints):
        compiled = model.joint(number)
        assert compiled.name == joint.name
        assert model.body(compiled.bodyid[0]).name == joint.body
        assert compiled.axis == pytest.approx(joint.axis)
        assert model.body(joint.body).pos == pytest.approx(joint.origin)
    assert model.geom("robot/base").size[0] == ROBOT.base_radius
    assert {model.camera(number).name for number in range(model.ncam)} == set(ROBOT.cameras)
    assert ROBOT.joint_names[ROBOT.torso_column] == "torso_lift_joint"
    assert ROBOT.joint_names[ROBOT.arm_columns] == ROBOT.arm_names == tuple(ORDER[4:11])
    assert ROBOT.joint_names[ROBOT.finger_columns] == tuple(ORDER[11:])
    set_pose(data, np.zeros(7))
    point = data.body(ROBOT.arm[-1].body).xpos + ROBOT.gripper_point
    assert data.site(ROBOT.gripper_site).xpos == pytest.approx(point, abs=1e-9)


def test_an_action_has_a_number_for_each_thing_that_the_robot_does():
    """Base forward and turn, seven joints of the arm, the gripper, "stop"."""
    columns = [*range(ROBOT.action_size)]
    action = ROBOT.action
    assert [action.forward, action.turn, *columns[action.arm], action.grip, action.stop] == list(range(11))


def test_masses_are_the_urdfs(model):
    for body, mass in MASSES.items():
        assert model.body(body).mass[0] == pytest.approx(mass, abs=1e-9), body
    assert model.body_subtreemass[0] == pytest.approx(120.934, abs=1e-3)


def test_inertia_of_the_base_follows_the_parallel_axis_theorem(model):
    """About the vertical through its middle, worked out by hand from the URDF's four parts."""
    com = (70.1294 * -0.0036 + 2 * 4.3542 * 0.0012914 + 13.2775 * (-0.086875 - 0.0722)) / MASSES["robot"]
    body = model.body("robot")
    assert body.ipos[0] == pytest.approx(com, abs=1e-9)
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, body.iquat)
    rotation = rotation.reshape(3, 3)
    vertical = (rotation @ np.diag(body.inertia) @ rotation.T)[2, 2]
    com_y = 13.2775 * 0.0057 / MASSES["robot"]
    parts = [
        (70.1294, 0.987, -0.0036, 0.0),
        (4.3542, 0.0045, 0.0012914, 0.18738),
        (4.3542, 0.0045, 0.0012914, -0.18738),
        (13.2775, 0.1018, -0.159075, 0.0057),
    ]
    expected = sum(i + m * ((x - com) ** 2 + (y - com_y) ** 2) for m, i, x, y in parts)
    assert vertical == pytest.approx(expected, rel=1e-6)


def test_efforts_are_the_urdfs_but_for_the_shoulder_pan(model):
    assert model.actuator_forcerange[3:, 1] == pytest.approx(EFFORTS)
    assert model.actuator_forcerange[:, 0] == pytest.approx(-model.actuator_forcerange[:, 1])
    assert model.actuator_forcerange[0, 1] < 120.934 * 9.81  # tyres cannot push harder than friction 1


def test_position_servos_are_of_60_radians_per_second_and_a_damping_ratio_of_0_7(model):
    """kp = I w^2 and kv = 2 z I w, whatever inertia I a servo is made for."""
    gains = model.actuator_gainprm[3:, 0]
    assert model.actuator_biasprm[3:, 1] == pytest.approx(-gains)
    assert model.actuator_biasprm[3:, 2] / gains == pytest.approx(np.full(10, -2 * 0.7 / 60))


def test_gravity_is_compensated_and_a_load_is_not(model):
    falls = {}
    for compensated in (True, False):
        spec = make_spec()
        add_fetch(spec, visuals=False)
        if not compensated:
            for body in spec.bodies:
                body.gravcomp = 0.0
        plain = spec.compile()
        plain.actuator_gainprm[:], plain.actuator_biasprm[:] = 0.0, 0.0
        data = mujoco.MjData(plain)
        set_pose(data)
        mujoco.mj_step(plain, data, 30)
        falls[compensated] = 1.0 - data.site("gripper").xpos[2]
    assert abs(falls[True]) < 1e-6
    assert falls[False] > 0.1


def test_at_rest_nothing_touches(model, data):
    set_pose(data)
    assert touching(data) == set()


def test_the_base_slides_four_centimeters_above_the_floor(model, data):
    set_pose(data)
    lowest = [
        data.geom_xpos[i][2] - model.geom_size[i][1] for i in range(model.ngeom) if model.geom(i).name == "robot/base"
    ]
    assert lowest == pytest.approx([0.04])


def test_closed_fingers_meet_and_open_ones_have_eight_centimeters_between_them(model, data):
    gaps = []
    for q in (0.0, 0.04):
        data.joint("l_gripper_finger_joint").qpos = data.joint("r_gripper_finger_joint").qpos = q
        mujoco.mj_forward(model, data)
        left, right = data.geom("robot/l_finger").xpos[1], data.geom("robot/r_finger").xpos[1]
        gaps.append(right - left - 2 * model.geom("robot/r_finger").size[1])
    assert gaps == pytest.approx([0.0, 0.08], abs=1e-3)


def test_visuals_change_what_is_seen_and_nothing_else(model):
    spec = make_spec()
    add_fetch(spec, visuals=False)
    plain = spec.compile()
    assert plain.ngeom == 12
    assert model.ngeom > 60
    ends = []
    for one in (model, plain):
        data = mujoco.MjData(one)
        set_pose(data)
        data.actuator("base_forward").ctrl, data.actuator("elbow_flex_joint").ctrl = 1.0, 0.5
        mujoco.mj_step(one, data, 60)
        ends.append(data.qpos.copy())
    assert ends[0] == pytest.approx(ends[1], abs=1e-12)
    assert plain.geom_group.tolist().count(4) == 1  # the bumper
    assert set(plain.geom_group) == {0, 4}
    seen_only = model.geom_group == 2
    assert not np.any(model.geom_contype[seen_only] | model.geom_conaffinity[seen_only])
    assert set(model.geom_group[~seen_only]) == {3, 4}
    assert model.ngeom - seen_only.sum() == 12


def test_head_camera_looks_from_and_to_where_m3s_does(model, data):
    set_pose(data)
    camera = data.cam("head")
    assert camera.xpos == pytest.approx((0.17, 0.0, 1.2), abs=1e-4)
    forward, right = -camera.xmat.reshape(3, 3)[:, 2], camera.xmat.reshape(3, 3)[:, 0]
    assert forward == pytest.approx(np.array([0.58, 0.0, -0.2]) / np.hypot(0.58, 0.2), abs=1e-6)
    assert right == pytest.approx([0.0, -1.0, 0.0], abs=1e-9)


def test_hand_camera_looks_along_the_fingers(model, data):
    set_pose(data, np.zeros(7))
    camera = data.cam("hand")
    assert -camera.xmat.reshape(3, 3)[:, 2] == pytest.approx([1.0, 0.0, 0.0], abs=1e-9)
    assert camera.xpos - data.body("gripper_link").xpos == pytest.approx([0.0, 0.0, 0.1], abs=1e-9)


@pytest.mark.parametrize("visuals", [True, False])
def test_robot_goes_into_an_apartment(visuals):
    spec = build_apartment(make_apartment(0, 0), visuals=visuals)
    furniture = build_apartment(make_apartment(0, 0), visuals=visuals).compile()
    add_fetch(spec, visuals=visuals)
    model = spec.compile()
    assert model.nv == furniture.nv + 13
    assert model.nu == 13


def test_importing_the_robot_loads_no_simulator():
    code = "import sys, perdure.home.sim.robot; print(sorted({'mujoco', 'scipy'} & set(sys.modules)))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
