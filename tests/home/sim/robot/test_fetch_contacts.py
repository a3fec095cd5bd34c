"""What the robot meets, and what it passes through."""

import mujoco
import numpy as np
import pytest
from fetch_scenes import STEPS_PER_COMMAND, make_spec, set_pose, touching

from perdure.home.sim.apartments import build_apartment, make_apartment
from perdure.home.sim.kinematics import gripper_pose
from perdure.home.sim.occupancy import free_space
from perdure.home.sim.robot import ROBOT, add_fetch
from tests.home.arm_poses import reach

BOX = mujoco.mjtGeom.mjGEOM_BOX


def with_box(center, half, timestep=1 / 120, contype=1, conaffinity=1):
    spec = make_spec(timestep)
    spec.worldbody.add_geom(name="box", type=BOX, pos=center, size=half, contype=contype, conaffinity=conaffinity)
    add_fetch(spec)
    model = spec.compile()
    return model, mujoco.MjData(model)


@pytest.mark.parametrize("name", ["robot/torso", "robot/head", "robot/base"])
def test_hand_in_the_body_is_a_contact(model, data, name):
    """An arm whose gripper point is inside the part: found by inverse kinematics, which knows no contacts."""
    inside = {"robot/torso": (0.0, 0.0, 0.85), "robot/head": (0.12, 0.0, 1.19), "robot/base": (0.2, 0.1, 0.34)}[name]
    found = reach(inside, ROBOT.rest_arm)
    assert found.error < 0.03
    set_pose(data, found.arm)
    assert any(name in pair and pair != (name,) for pair in touching(data))


def test_no_arm_touches_itself_and_no_body_its_own_arm(model, data, random_arms):
    """Only what comes after the elbow may meet base, torso and head."""
    hand = {"robot/forearm", "robot/wrist", "robot/palm", "robot/l_finger", "robot/r_finger"}
    body = {"robot/base", "robot/column", "robot/torso", "robot/head"}
    met = 0
    for arm in random_arms:
        set_pose(data, arm)
        for first, second in touching(data):
            met += 1
            assert {first, second} & hand
            assert {first, second} & body
    assert met > 0


def test_hand_pushed_against_the_torso_stays_outside():
    """The arm is asked to fold into the torso and stops at it; without the second bit it goes through."""
    middles = {}
    for solid in (True, False):
        spec = make_spec()
        add_fetch(spec)
        model = spec.compile()
        if not solid:
            model.geom_conaffinity[model.geom("robot/torso").id] = 0
        data = mujoco.MjData(model)
        set_pose(data)
        goal = reach((0.0, 0.0, 0.85), ROBOT.rest_arm).arm
        for share in np.linspace(0.0, 1.0, 90):
            data.ctrl[4:11] = (1.0 - share) * ROBOT.rest_arm + share * goal
            mujoco.mj_step(model, data, 4)
        local = data.body("torso_lift_link").xmat.reshape(3, 3).T @ (
            data.site("gripper").xpos - data.geom("robot/torso").xpos
        )
        middles[solid] = np.max(np.abs(local) - model.geom("robot/torso").size)
    assert middles[False] < 0.0 < middles[True]


@pytest.mark.parametrize("timestep", sorted(STEPS_PER_COMMAND))
def test_base_is_stopped_by_a_wall(timestep):
    model, data = with_box((1.0, 0.0, 0.3), (0.1, 1.0, 0.3), timestep)
    set_pose(data)
    data.actuator("base_forward").ctrl = 1.5
    speeds = []
    for _ in range(60):
        mujoco.mj_step(model, data, STEPS_PER_COMMAND[timestep])
        speeds.append(abs(data.joint("base_x").qvel[0]))
    assert max(speeds) > 1.0
    assert max(speeds[-15:]) < 0.01
    assert data.body("robot").xpos[0] == pytest.approx(0.9 - 0.285, abs=0.01)
    force = np.zeros(6)
    mujoco.mj_contactForce(model, data, 0, force)
    assert 0.0 < force[0] <= 801.0


def test_base_drives_through_what_must_not_touch_it():
    """Objects that must not meet the robot have (contype, conaffinity) = (1, 0)."""
    model, data = with_box((1.0, 0.0, 0.3), (0.1, 1.0, 0.3), contype=1, conaffinity=0)
    set_pose(data)
    data.actuator("base_forward").ctrl = 1.5
    mujoco.mj_step(model, data, 240)
    assert data.body("robot").xpos[0] > 2.0


@pytest.mark.parametrize("timestep", sorted(STEPS_PER_COMMAND))
def test_arm_pressed_on_a_table_stays_still(timestep):
    """The shoulder asks for half a radian more than the table lets it."""
    model, data = with_box((0.75, 0.0, 0.72), (0.3, 0.5, 0.02), timestep)
    set_pose(data)
    steps, speeds, forces = STEPS_PER_COMMAND[timestep], [], []
    for command in range(120):
        if command < 60:
            data.actuator("shoulder_lift_joint").ctrl[0] += 0.0125
        force, pressed = np.zeros(6), 0.0
        for _ in range(steps):
            mujoco.mj_step(model, data)
            speeds.append(np.abs(data.qvel).max())
        for i in range(data.ncon):
            mujoco.mj_contactForce(model, data, i, force)
            pressed += force[0]
        forces.append(pressed)
    assert 100.0 < forces[-1] < 600.0
    assert np.ptp(forces[-30:]) < 1.0
    assert max(speeds[-30 * steps :]) < 0.01
    assert data.site("gripper").xpos[2] > 0.72


def test_gripper_reaches_a_table_it_may_touch():
    """Where inverse kinematics says the fingers meet the table's top, they do."""
    _, data = with_box((0.75, 0.0, 0.72), (0.3, 0.5, 0.02))
    down = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    for height, meets in ((0.80, False), (0.765, True)):
        found = reach((0.75, 0.0, height), ROBOT.rest_arm, rotation=down)
        assert gripper_pose(0.15, found.arm)[0] == pytest.approx((0.75, 0.0, height), abs=1e-4)
        set_pose(data, found.arm)
        assert bool(touching(data)) == meets


def test_in_an_apartment_the_robot_touches_nothing_where_it_is_free_and_much_where_it_is_not():
    apartment = make_apartment(2, 5)
    spec = build_apartment(apartment, visuals=False)
    add_fetch(spec, visuals=False)
    model = spec.compile()
    data, space = mujoco.MjData(model), free_space(apartment, {})
    rng = np.random.default_rng(3)
    centers = space.centers[space.island]
    tucked = np.array(reach((0.2, -0.1, 1.55), ROBOT.rest_arm).arm)  # high above the furniture's footprints
    for x, y in centers[rng.choice(len(centers), 20, replace=False)]:
        set_pose(data, tucked, base=(x, y, rng.uniform(-3, 3)))
        names = {name for pair in touching(data) for name in pair if name.startswith("robot/")}
        assert not names & {"robot/base", "robot/column", "robot/torso"}
    sofa = apartment.piece("sofa").pose
    set_pose(data, tucked, base=(sofa.x, sofa.y, 0.0))
    assert any("robot/base" in pair for pair in touching(data))
