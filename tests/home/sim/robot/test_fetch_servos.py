"""The servos do what the skills ask of them, at both physics steps."""

import mujoco
import numpy as np
import pytest
from fetch_scenes import STEPS_PER_COMMAND, arm_angles, make_spec, set_pose

from perdure.home.sim.robot import ROBOT, add_fetch

COMMAND = 0.025
TIMESTEPS = sorted(STEPS_PER_COMMAND)


def loaded_model(timestep, load=0.52):
    """The robot with the heaviest object fixed in its gripper, nothing colliding."""
    spec = make_spec(timestep)
    add_fetch(spec, visuals=False)
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
    held = spec.body("gripper_link").add_body(name="load")
    held.mass, held.inertia, held.explicitinertial = load, (1e-3, 1e-3, 1e-3), True
    return spec.compile()


def follow(model, start, signs, commands=30, base=(0.0, 0.0, 0.0)):
    """Worst lag at the end of a command, per joint, and the data after the last one."""
    data = mujoco.MjData(model)
    set_pose(data, start)
    steps = round(1 / 30 / model.opt.timestep)
    mujoco.mj_step(model, data, 20 * steps)
    data.ctrl[:3] = base
    target, worst = np.array(start), np.zeros(7)
    for _ in range(commands):
        target = np.clip(target + COMMAND * signs, ROBOT.arm_low, ROBOT.arm_high)
        for joint, value in zip(ROBOT.arm_names, target, strict=True):
            data.actuator(joint).ctrl = value
        mujoco.mj_step(model, data, steps)
        worst = np.maximum(worst, np.abs(target - arm_angles(data)))
    return worst, target, data


@pytest.mark.parametrize("timestep", TIMESTEPS)
def test_arm_with_a_load_follows_the_fastest_commands_within_three_hundredths(timestep, random_arms):
    model, rng = loaded_model(timestep), np.random.default_rng(0)
    for start in (ROBOT.rest_arm, np.zeros(7), *(0.8 * random_arms[:6])):
        lag, _, _ = follow(model, start, rng.choice([-1.0, 1.0], 7))
        assert lag.max() < 0.03


def test_servos_a_tenth_as_stiff_do_not_follow():
    model = loaded_model(1 / 120)
    model.actuator_gainprm[3:, 0] *= 0.1
    model.actuator_biasprm[3:, 1] *= 0.1
    lag, _, _ = follow(model, ROBOT.rest_arm, np.ones(7))
    assert lag.max() > 0.1


@pytest.mark.parametrize("timestep", TIMESTEPS)
def test_arm_comes_to_rest_without_ringing(timestep):
    model = loaded_model(timestep)
    _, target, data = follow(model, ROBOT.rest_arm, np.array([1.0, 1.0, -1.0, 1.0, -1.0, -1.0, 1.0]), commands=20)
    speeds, passed = [], np.zeros(7)
    for _ in range(30):
        mujoco.mj_step(model, data, STEPS_PER_COMMAND[timestep])
        speeds.append(np.abs(data.qvel[4:11]).max())
        passed = np.maximum(passed, np.abs(arm_angles(data) - target))
    assert max(speeds[15:]) < 0.01
    assert speeds[-1] < 1e-3
    assert passed.max() < 0.03
    assert np.abs(arm_angles(data) - target).max() < 2e-3  # what the load bends


@pytest.mark.parametrize("timestep", TIMESTEPS)
def test_arm_keeps_its_pose_while_the_base_starts_at_full_speed(timestep):
    for start in (ROBOT.rest_arm, np.zeros(7)):
        lag, _, data = follow(loaded_model(timestep), start, np.zeros(7), commands=20, base=(1.5, 0.0, 1.5))
        assert lag.max() < 0.05
    # In a turn the servos lag behind by what pulls outwards.
    assert data.actuator("base_forward").velocity[0] == pytest.approx(1.5, abs=0.06)
    assert data.actuator("base_turn").velocity[0] == pytest.approx(1.5, abs=0.06)


def test_with_the_urdfs_own_effort_the_shoulder_would_give_way():
    model = loaded_model(1 / 120)
    model.actuator("shoulder_pan_joint").forcerange[:] = (-33.82, 33.82)
    lag, _, _ = follow(model, np.zeros(7), np.zeros(7), commands=20, base=(1.5, 1.5, 1.5))
    assert lag[0] > 0.1


def test_base_commands_are_velocities_along_its_own_axes():
    model = loaded_model(1 / 120)
    data = mujoco.MjData(model)
    set_pose(data, base=(0.0, 0.0, 0.5 * np.pi))
    data.actuator("base_forward").ctrl, data.actuator("base_left").ctrl = 0.5, -0.25
    mujoco.mj_step(model, data, 240)
    assert data.body("robot").xpos[:2] == pytest.approx([0.5, 1.0], abs=0.05)
    assert data.joint("base_yaw").qpos[0] == pytest.approx(0.5 * np.pi, abs=0.01)


def slide(model, speed):
    """Largest displacement in [m] across a heading of 20 degrees while the base starts and brakes."""
    heading = np.radians(20.0)
    data, across = mujoco.MjData(model), np.array([-np.sin(heading), np.cos(heading)])
    set_pose(data, base=(0.0, 0.0, heading))
    rooms = model.actuator(0).name == "base_x"
    worst = 0.0
    for command in (speed, 0.0):
        data.ctrl[:2] = (command * np.cos(heading), command * np.sin(heading)) if rooms else (command, 0.0)
        for _ in range(60):
            mujoco.mj_step(model, data)
            worst = max(worst, abs(float(across @ data.qpos[:2])))
    return worst


@pytest.mark.parametrize("speed", [1.5, 3.0])
def test_base_does_not_slide_sideways_when_it_starts_and_brakes(speed):
    assert slide(loaded_model(1 / 120), speed) < 0.01


def test_with_servos_along_the_axes_of_the_room_it_would_slide():
    spec = make_spec(1 / 120)
    add_fetch(spec, visuals=False)
    for joint, actuator in zip(("base_x", "base_y"), spec.actuators[:2], strict=True):
        actuator.name = actuator.target = joint
        actuator.trntype, actuator.gear = mujoco.mjtTrn.mjTRN_JOINT, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    assert slide(spec.compile(), 3.0) > 0.1


def slip(limit):
    """Largest sideways speed in [m/s] in the skills' fastest turn, for a limit of the sideways force in [N]."""
    model = loaded_model(1 / 120)
    model.actuator("base_left").forcerange[:] = (-limit, limit)
    data, worst = mujoco.MjData(model), 0.0
    set_pose(data)
    data.actuator("base_forward").ctrl = data.actuator("base_turn").ctrl = 3.0
    for _ in range(240):
        mujoco.mj_step(model, data)
        worst = max(worst, abs(float(data.actuator("base_left").velocity[0])))
    return worst


def test_base_hardly_slips_sideways_in_a_turn_because_all_its_weight_holds_it():
    assert loaded_model(1 / 120).actuator("base_left").forcerange[1] == 1200.0
    assert slip(1200.0) < 0.15
    assert slip(800.0) > 1.0  # less than m v w = 1,089 N: it would drift outwards


def test_torso_lifts_the_arm_and_holds_it():
    model = loaded_model(1 / 120)
    data = mujoco.MjData(model)
    set_pose(data)
    before = data.site("gripper").xpos.copy()
    data.actuator("torso_lift_joint").ctrl = 0.3
    mujoco.mj_step(model, data, 240)
    assert data.site("gripper").xpos - before == pytest.approx([0.0, 0.0, 0.15], abs=1e-3)


def test_fingers_open_and_close():
    model = loaded_model(1 / 120)
    data = mujoco.MjData(model)
    set_pose(data)
    for q in (0.04, 0.0):
        for joint in ROBOT.joint_names[-2:]:
            data.actuator(joint).ctrl = q
        mujoco.mj_step(model, data, 30)
        assert [data.joint(joint).qpos[0] for joint in ROBOT.joint_names[-2:]] == pytest.approx([q, q], abs=1e-3)
