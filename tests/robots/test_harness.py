"""What stands between policy and motors, against closed forms and MuJoCo's own sensors."""

import math

import mujoco
import numpy as np
import pytest
from msgspec.structs import replace

from perdure.errors import PerdureError
from perdure.robots.check import check
from perdure.robots.contract import VALUES, HeldJoints, Term
from perdure.robots.harness import HeadingCorrection
from perdure.robots.terms import RobotState
from perdure.robots.world import VelocityCommandEnv, compiled
from tests.robots.conftest import act

ROBOT = """<mujoco><option gravity='0 0 {gravity}'/>
<worldbody><body name='base' pos='0 0 3'><freejoint/><geom size='.2'/>
<site name='tilted' pos='.1 .2 .3' euler='20 30 40'/>
<body name='torso'><joint name='waist' axis='0 0 1'/><geom size='.1' pos='0 .3 .1'/>
<site name='high' pos='.05 0 .4' euler='-30 10 80'/></body>
<body><joint name='hip' axis='0 1 0' armature='0.1'/><geom size='.1' pos='0 0 -.4'/></body></body></worldbody>
<sensor>{sensors}</sensor></mujoco>"""
SENSORS = """<velocimeter site='{0}'/><gyro site='{0}'/><framezaxis objtype='body' objname='world' reftype='site'
refname='{0}'/><framelinvel objtype='xbody' objname='base'/><frameangvel objtype='xbody' objname='base'/>"""


@pytest.fixture
def leg(ant, tmp_path):
    """A robot with a hip that is driven and a waist that is not."""

    def made(gravity=0.0, **changes):
        (tmp_path / "robot.xml").write_text(ROBOT.format(gravity=gravity, sensors=""))
        one = dict.fromkeys(VALUES) | {"default_pose": (0.0,), "stiffness": (100.0,), "damping": (5.0,)}
        values = {**one, "action_scale": (1.0,), "joints": ("hip",), "model": str(tmp_path / "robot.xml"), **changes}
        return replace(ant, **values)

    return made


def test_constants_are_extra_commands(ant):
    terms = Term("height_command", value=0.3), Term("head", value=(0.1, -0.2), scale=(1.0, 5.0)), Term("command")
    contract = replace(ant, observations=tuple(replace(term, history=1) for term in terms))
    env = VelocityCommandEnv(contract)
    assert env.reset(seed=0)[0] == pytest.approx([0.3, 0.1, -1.0, *contract.command])
    assert env.observation_names[:2] == ("height_command[0]", "head[0]")


@pytest.mark.parametrize("place", ["tilted", "high"])
def test_an_imu_measures_what_the_sensors_of_mujoco_do(leg, place):
    contract = leg(imu=place)
    model = mujoco.MjModel.from_xml_string(ROBOT.format(gravity=0, sensors=SENSORS.format(place)))
    sensing = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    sensing.qpos[:] = rng.normal(size=model.nq)
    sensing.qpos[3:7] /= np.linalg.norm(sensing.qpos[3:7])
    sensing.qvel[:] = rng.normal(size=model.nv)
    mujoco.mj_forward(model, sensing)

    ours = compiled(contract, False)
    data = mujoco.MjData(ours)
    data.qpos[:] = sensing.qpos
    data.qvel[:] = sensing.qvel
    robot = RobotState(contract, ours, data)
    robot.read_base()
    expected = sensing.sensordata.reshape(5, 3) * [[1], [1], [-1], [1], [1]]
    assert np.allclose([*robot.imu, robot.world_velocity, robot.world_turning], expected)


def test_without_a_place_the_imu_is_in_the_base_and_an_unknown_one_is_refused(leg):
    contract = leg(observations=(Term("imu_ang_vel", history=1), Term("base_ang_vel", history=1)))
    env = VelocityCommandEnv(contract)
    env.reset(seed=0)
    seen = env.step(np.ones(1))[0]
    assert np.array_equal(seen[:3], seen[3:])
    assert np.abs(seen).max() > 0.1
    with pytest.raises(PerdureError, match=r"imu: .*'hihg'.*did you mean 'high'"):
        VelocityCommandEnv(replace(contract, imu="hihg"))


def test_held_joints_stay_at_their_pose_and_are_not_the_policys(leg):
    held = HeldJoints(("wai.*",), 0.4, 500.0, 20.0)
    env = VelocityCommandEnv(leg(gravity=-9.81, held=(held,)))
    env.reset(seed=0)
    assert env.action_space.shape == (1,)
    waist = env.data.joint("waist")
    assert waist.qpos[0] == pytest.approx(0.4)
    for _ in range(10):
        env.step(np.ones(1))
    assert waist.qpos[0] == pytest.approx(0.4, abs=0.02)
    servo = 500.0 * (0.4 - waist.qpos[0]) - 20.0 * waist.qvel[0]
    mujoco.mj_forward(env.model, env.data)
    assert env.data.actuator_force[1] == pytest.approx(servo)
    loose = "no controller holds these joints"
    assert not any(loose in line for line in check(env.contract, None)[0])
    assert any(f"{loose} of the model: waist" in line for line in check(leg(), None)[0])


@pytest.mark.parametrize(
    ("held", "message"),
    [
        (HeldJoints(("knee",)), "no joint of the model matches 'knee'"),
        (HeldJoints(("hip",)), "no joint of the model matches 'hip'"),
        (HeldJoints(("(",)), "no regular expression"),
        (HeldJoints(("waist",), (0.0, 1.0)), "pose has 2 values for 1 joints"),
    ],
)
def test_held_joints_that_do_not_fit_are_refused(leg, held, message):
    with pytest.raises(PerdureError, match=message):
        compiled(leg(held=(held,)), False)


def test_delayed_targets_are_those_of_earlier_actions(ant):
    late = VelocityCommandEnv(replace(ant, action_delay=2))
    plain = VelocityCommandEnv(ant)
    actions = np.random.default_rng(0).normal(size=(8, 8))
    for _ in range(2):  # the second episode does not begin with targets of the first
        late.reset(seed=1)
        plain.reset(seed=1)
        for step, action in enumerate(actions):
            seen = late.step(action)[0]
            plain.step(actions[step - 2] if step >= 2 else np.zeros(8))
            assert np.array_equal(late.data.qpos, plain.data.qpos)
            assert np.array_equal(seen[25:33], action), "a policy observes its own action at once"


@pytest.mark.parametrize(
    ("saturation", "speed", "torque"),
    [
        (None, 9.0, 50.0),
        (None, 10.5, 0.0),
        (None, -10.5, 50.0),
        ((80.0,), 2.0, 50.0),  # 80 x (1 - 2 / 10) is above the limit of 50
        ((80.0,), 5.0, 40.0),
        ((80.0,), 12.0, 0.0),
    ],
)
def test_torque_falls_with_the_speed_of_a_motor(leg, saturation, speed, torque):
    limits = {"effort_limit": (50.0,), "velocity_limit": (10.0,), "saturation_effort": saturation, "decimation": 1}
    env = VelocityCommandEnv(leg(damping=(0.0,), **limits))
    env.reset(seed=0)
    env.data.joint("hip").qvel = speed
    env.step(np.full(1, 2.0))  # asks for about 200 N m
    assert env.data.actuator_force[0] == pytest.approx(torque, abs=1e-6)


def test_below_its_limits_a_motor_is_the_same_with_and_without_them(ant):
    walks = []
    for limit in (None, (1e6,) * 8):
        env = VelocityCommandEnv(replace(ant, velocity_limit=limit))
        observation, _ = env.reset(seed=0)
        for _ in range(20):
            observation, *_ = env.step(act(observation))
        walks.append(env.data.qpos.copy())
    assert np.allclose(*walks, atol=1e-6)


def test_the_integral_of_the_heading_error_grows_to_its_limit(ant):
    heading = HeadingCorrection(replace(ant, heading_control_stiffness=0.5, heading_control_integral=0.2))
    forward = (0.5, 0.0, 0.0)
    told = [heading.rate(forward, 0.1, 0.5) for _ in range(4)]
    assert told == pytest.approx([-0.05 - 0.2 * 0.1 * 0.5 * step for step in range(4)])
    for _ in range(1000):
        heading.rate(forward, 0.1, 0.5)
    assert heading.rate(forward, 0.1, 0.5) == -1.0
    assert heading.rate(forward, -0.4, 0.5) == pytest.approx(-0.8)  # the integral has not grown beyond 1 rad/s
    assert heading.rate((0.0, 0.0, 0.0), -0.4, 0.5) == 0.0, "a robot that stands begins anew"
    assert heading.rate(forward, -0.4, 0.5) == 0.0


@pytest.mark.parametrize("standing", ["stop", "run"])
def test_one_gait_clock_stops_or_runs_while_the_robot_stands(ant, standing):
    changes = {"gait_offsets": (0.0,), "gait_period": 0.8, "gait_while_standing": standing, "command": (0.0, 0.0, 0.0)}
    env = VelocityCommandEnv(replace(ant, observations=(Term("gait_phase", history=1),), **changes))
    found = [env.reset(seed=0)[0], *(env.step(np.zeros(8))[0] for _ in range(3))]
    angles = 2.0 * math.pi * 0.05 / 0.8 * np.arange(4.0)
    if standing == "stop":
        angles = np.full(4, math.pi)
    assert np.allclose(found, np.stack([np.sin(angles), np.cos(angles)], axis=1), atol=1e-9)
