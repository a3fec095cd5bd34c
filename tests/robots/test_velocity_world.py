"""The environment against MuJoCo's own quantities: observations, torques, falls, rewards; and disturbances on it."""

import math

import gymnasium
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from msgspec.structs import replace

from perdure.disturbances import parse_disturbances
from perdure.envs import make_world, task_of_environment
from perdure.envs.disturbances import DisturbedWorld
from perdure.errors import PerdureError
from perdure.horizon import Constant, Geometric
from perdure.robots.contract import Term
from perdure.robots.world import VelocityCommandEnv, compiled, sources
from perdure.wrappers import Disturb, TimeToGoObservation
from tests.envs.test_disturbances import change
from tests.robots.conftest import ANT, act

ALL = ("base_lin_vel", "base_ang_vel", "projected_gravity", "command", "joint_pos", "joint_vel", "actions")


@pytest.fixture
def env(ant):
    """The Ant after some steps of random actions."""
    terms = tuple(Term(name, history=1) for name in (*ALL, "sin_phase", "cos_phase"))
    made = VelocityCommandEnv(replace(ant, observations=terms, command=(0.3, 0.1, -0.2)))
    made.reset(seed=1)
    rng = np.random.default_rng(0)
    for _ in range(7):
        made.last, *_ = made.step(rng.uniform(-1.0, 1.0, 8))
    return made


def body_velocity(env):
    """Linear and angular velocity of the base in its own frame, as MuJoCo computes them."""
    mujoco.mj_forward(env.model, env.data)
    velocity = np.zeros(6)
    mujoco.mj_objectVelocity(env.model, env.data, mujoco.mjtObj.mjOBJ_XBODY, 1, velocity, 1)
    return velocity[3:], velocity[:3]


def test_observations_are_those_of_mujoco(env):
    observation, action = env.step(np.linspace(-1.0, 1.0, 8))[0], np.linspace(-1.0, 1.0, 8)
    linear, angular = body_velocity(env)
    gravity = env.data.xmat[1].reshape(3, 3).T @ [0.0, 0.0, -1.0]
    joints = [env.data.joint(name) for name in env.contract.joints]
    pose = [each.qpos[0] for each in joints] - env.contract.values("default_pose")
    phases = 2.0 * np.pi * (8 * 0.05 + np.array([0.0, 0.5]))
    expected = [linear, angular, gravity, [0.3, 0.1, -0.2], pose, [each.qvel[0] for each in joints], action]
    assert np.abs(linear).min() > 1e-3
    assert np.abs(angular).min() > 1e-3
    assert observation == pytest.approx(np.concatenate([*expected, np.sin(phases), np.cos(phases)]), abs=1e-9)


def test_a_step_is_position_control_in_every_physics_step(env):
    action, twin = np.linspace(1.0, -1.0, 8), VelocityCommandEnv(env.contract)
    state = np.zeros(mujoco.mj_stateSize(env.model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(env.model, env.data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    mujoco.mj_setState(twin.model, twin.data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    twin.data.qacc_warmstart[:] = env.data.qacc_warmstart
    env.model.opt.integrator = twin.model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    twin.model.actuator_gainprm[:, 0], twin.model.actuator_biasprm[:] = 1.0, 0.0  # plain motors
    contract = env.contract
    target = contract.values("default_pose") + contract.values("action_scale") * action
    joints = [twin.data.joint(name) for name in contract.joints]
    for _ in range(5):
        position, velocity = (np.array([getattr(each, name)[0] for each in joints]) for name in ("qpos", "qvel"))
        torque = contract.values("stiffness") * (target - position) - contract.values("damping") * velocity
        twin.data.ctrl[:] = torque.clip(-150.0, 150.0)  # the gear of the Ant's motors
        mujoco.mj_step(twin.model, twin.data)
    env.step(action)
    assert np.allclose(env.data.qpos, twin.data.qpos, atol=1e-9)
    assert np.abs(env.model.actuator_forcerange).tolist() == [[150.0, 150.0]] * 8


def test_the_reward_is_the_product_of_the_tracking_terms(env):
    _, reward, fell, truncated, info = env.step(np.zeros(8))
    linear, angular = body_velocity(env)
    squared = (0.3 - linear[0]) ** 2 + (0.1 - linear[1]) ** 2
    assert reward == pytest.approx(math.exp(-squared / 0.25) * math.exp(-((-0.2 - angular[2]) ** 2) / 0.5))
    assert (fell, truncated) == (False, False)
    assert info["velocity_error"] > 0.0


def test_a_fall_takes_back_what_the_last_second_earned(ant):
    env = VelocityCommandEnv(ant)
    env.reset(seed=0)
    earned = [env.step(np.zeros(8))[1] for _ in range(30)]
    env.data.qpos[3:7] = 0.0, 1.0, 0.0, 0.0
    _, reward, fell, _, _ = env.step(np.zeros(8))
    assert fell
    assert reward == pytest.approx(-sum(earned[-19:]))  # a second has 20 steps, and this one earns nothing either


def test_a_start_touches_the_floor_and_depends_on_its_seed(ant):
    env = VelocityCommandEnv(ant)
    first, second, again = (env.reset(seed=seed)[0] for seed in (1, 2, 1))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, second)
    env.data.qpos[:] = env.init_qpos
    mujoco.mj_forward(env.model, env.data)
    # The Ant's feet are capsules; 10 mm of air, and MuJoCo's margin of 10 mm on both sides.
    lowest = min(each.dist for each in env.data.contact)
    assert lowest == pytest.approx(0.01, abs=1e-6)


@pytest.mark.parametrize(("tilt", "falls"), [(60.0, False), (80.0, True)])
def test_a_tilted_base_is_a_fall(ant, tilt, falls):
    env = VelocityCommandEnv(ant)
    env.reset(seed=0)
    env.data.qpos[2] = 5.0
    env.data.qpos[3:7] = math.cos(math.radians(tilt / 2)), math.sin(math.radians(tilt / 2)), 0.0, 0.0
    assert env.step(np.zeros(8))[2] is falls


@pytest.mark.parametrize(
    ("command", "stiffness", "yaw", "told"),
    [
        ((0.5, 0.0, 0.0), 0.5, 0.3, -0.15),
        ((0.5, 0.0, 0.0), 0.5, -3.0, 1.0),
        ((0.5, 0.0, 0.2), 0.5, 0.3, 0.2),
        ((0.0, 0.0, 0.0), 0.5, 0.3, 0.0),
        ((0.5, 0.0, 0.0), 0.0, 0.3, 0.0),
    ],
)
def test_a_robot_is_told_to_turn_back_to_its_heading(ant, command, stiffness, yaw, told):
    terms = Term("command_ang_vel", history=1), Term("command_lin_vel", history=1)
    env = VelocityCommandEnv(replace(ant, observations=terms, command=command, heading_control_stiffness=stiffness))
    assert env.reset(seed=0)[0] == pytest.approx([command[2], *command[:2]])
    env.data.qpos[2:7] = 2.0, np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)  # in the air, so that nothing turns it
    env.data.qvel[:] = 0.0
    assert env.step(np.zeros(8))[0] == pytest.approx([told, *command[:2]], abs=1e-3)


def test_after_a_commanded_turn_a_robot_is_told_to_keep_the_heading_that_it_has(ant):
    terms, script = (Term("command_ang_vel", history=1),), ((0.0, 0.5, 0.0, 0.2), (0.1, 0.5, 0.0, 0.0))
    env = VelocityCommandEnv(replace(ant, observations=terms, script=script, heading_control_stiffness=0.5))
    told = [float(env.reset(seed=0)[0][0])]
    for yaw in (3.0, 3.0, -3.0):
        env.data.qpos[2:7] = 2.0, np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)
        env.data.qvel[:] = 0.0
        told.append(float(env.step(np.zeros(8))[0][0]))
    assert told == pytest.approx([0.2, 0.2, 0.0, -0.5 * (2.0 * np.pi - 6.0)], abs=2e-3)


@pytest.mark.parametrize(("trunk", "falls"), [((), True), (("front_left_leg",), False)])
def test_the_trunk_on_the_floor_is_a_fall(ant, trunk, falls):
    env = VelocityCommandEnv(replace(ant, trunk=trunk))
    env.reset(seed=0)
    env.data.qpos[2] = 0.2  # its torso has a radius of 0.25
    mujoco.mj_forward(env.model, env.data)
    assert env._fell() is falls


def test_a_robot_without_a_command_keeps_its_phases(ant):
    terms = (Term("sin_phase", history=1), Term("cos_phase", history=1))
    env = VelocityCommandEnv(replace(ant, observations=terms, script=((0, 0, 0, 0), (0.1, 1, 0, 0))))
    found = [env.reset(seed=0)[0], *(env.step(np.zeros(8))[0] for _ in range(4))]
    stands, begins = [0.0, 0.0, -1.0, -1.0], [0.0, 0.0, 1.0, -1.0]
    angle = 2.0 * np.pi * (0.05 + np.array([0.0, 0.5]))
    expected = [stands, stands, begins, [*np.sin(angle), *np.cos(angle)]]
    assert np.allclose(found[:4], expected, atol=1e-9)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"joints": (*(f"hip_{k}" for k in range(1, 5)), *(f"knee_{k}" for k in range(1, 5)))}, "no joint 'knee_1'"),
        ({"trunk": ("pelvis",)}, "no body pelvis"),
        ({"model": "nothing.xml"}, "nothing.xml"),
    ],
)
def test_a_contract_that_does_not_fit_its_model_is_refused(ant, changes, message):
    with pytest.raises(PerdureError, match=message):
        compiled(replace(ant, **changes), False)


def test_a_robot_without_a_free_base_is_refused(ant, tmp_path):
    text = "<mujoco><worldbody><body><joint name='hip'/><geom size='1'/></body></worldbody></mujoco>"
    (tmp_path / "arm.xml").write_text(text)
    one = dict.fromkeys(("default_pose", "stiffness", "damping", "action_scale"), (1.0,))
    with pytest.raises(PerdureError, match="free joint"):
        compiled(replace(ant, model=str(tmp_path / "arm.xml"), joints=("hip",), **one), False)


LEG = """<mujoco><default><motor ctrlrange='-1 1' gear='40'/><geom contype='0'/></default>
<worldbody><body pos='0 0 3'><freejoint/><geom size='.1'/>
<body><joint name='hip' axis='0 1 0' actuatorfrcrange='-5 5'/><geom size='.1' pos='0 0 .3'/></body>
</body></worldbody></mujoco>"""


@pytest.mark.parametrize(("limit", "strength", "torque"), [(None, 1.0, 5.0), ((50.0,), 1.0, 50.0), (None, 1.5, 7.5)])
def test_a_torque_limit_of_the_contract_or_of_a_disturbance_replaces_the_joints(ant, tmp_path, limit, strength, torque):
    (tmp_path / "leg.xml").write_text(LEG)
    one = dict.fromkeys(("default_pose", "damping"), (0.0,)) | dict.fromkeys(("stiffness", "action_scale"), (100.0,))
    leg = replace(ant, model=str(tmp_path / "leg.xml"), joints=("hip",), trunk=(), effort_limit=limit, **one)
    model = compiled(leg, False)
    assert model.geom_contype[0] == 1, "the defaults of the model change neither the floor nor the controllers"
    change(model, f"strength:{strength}")
    data = mujoco.MjData(model)
    data.ctrl[:] = 3.0
    mujoco.mj_forward(model, data)
    assert (data.actuator_force[0], data.qfrc_actuator[-1]) == (torque, torque)


def test_a_model_is_compiled_again_when_a_file_that_it_includes_has_changed(ant, tmp_path):
    (tmp_path / "leg.xml").write_text("<mujoco><include file='body.xml'/></mujoco>")
    one = dict.fromkeys(("default_pose", "damping"), (0.0,)) | dict.fromkeys(("stiffness", "action_scale"), (100.0,))
    leg = replace(ant, model=str(tmp_path / "leg.xml"), joints=("hip",), trunk=(), effort_limit=None, **one)
    (tmp_path / "body.xml").write_text(LEG)
    before = compiled(leg, False)
    assert compiled(leg, False) is before
    (tmp_path / "body.xml").write_text(LEG.replace("size='.1' pos", "size='.2' pos"))
    assert compiled(leg, False).geom_size[-1, 0] == 0.2


def test_a_term_that_is_scaled_to_nothing_is_zero(ant):
    scales = (0.0, 1.0, -2.0)
    env = VelocityCommandEnv(replace(ant, observations=(Term("base_ang_vel", scale=scales, history=1),)))
    observation = env.reset(seed=0)[0]
    assert np.isfinite(observation).all()
    assert observation[0] == 0.0


def test_gymnasium_makes_it():
    env = gymnasium.make("perdure.robots:perdure/VelocityCommand-v0", robot=str(ANT))
    check_env(env.unwrapped, skip_render_check=True)
    assert env.unwrapped.dt == pytest.approx(0.05)


def test_a_contract_is_a_task():
    assert task_of_environment(str(ANT)) == str(ANT)
    world = make_world(str(ANT), [0, 1])
    assert (world.spec.name, world.spec.step_seconds) == (str(ANT), pytest.approx(0.05))
    assert world.spec.engine.endswith(mujoco.__version__)
    assert world.spec.observation_names[3:7] == (*(f"projected_gravity[{k}]" for k in range(3)), "command[0]")
    models = [env.unwrapped.model for env in world.environments]
    assert models[0] is not models[1]  # disturbances change them
    world.close()


def test_disturbances_change_the_robot():
    world = make_world(str(ANT), [0])
    (env,) = world.environments
    before = {name: getattr(env.unwrapped.model, name).copy() for name in ("actuator_gear", "actuator_gainprm")}
    limits = env.unwrapped.model.actuator_forcerange.copy()
    texts = ("strength:0.5", "push:1.0", "action_delay:2", "observation_noise:0.1", "payload:0.2", "time_step:0.5")
    disturbed = DisturbedWorld(world, parse_disturbances(texts), [0], np.ones((1, 45)))
    model = env.unwrapped.model
    assert np.array_equal(model.actuator_gear, before["actuator_gear"])  # it also turns what a servo measures
    assert np.allclose(model.actuator_gainprm, 0.5 * before["actuator_gainprm"])
    assert np.allclose(model.actuator_forcerange, 0.5 * limits)
    assert (env.unwrapped.frame_skip, env.unwrapped.dt) == (10, pytest.approx(0.05))
    observations = disturbed.reset()
    for _ in range(201):
        step = disturbed.step(act(observations.astype(np.float32)))
        observations = step.observations
        if step.ended[0]:
            disturbed.reset()
    assert set(disturbed.infos[0]) == {"heading_error", "lateral_drift", "velocity_error", "energy_per_meter"}
    disturbed.close()


ACTIONS = slice(25, 33)
"""Of the Ant's observation."""


def delayed_walk(observes, steps=40):
    """Poses of an Ant on which each action acts a step late, by a policy that also uses its last action."""
    env, last, waiting, poses = VelocityCommandEnv(str(ANT)), np.zeros(8), np.zeros(8), []
    observation, _ = env.reset(seed=1)
    for _ in range(steps):
        own = (act(observation) + 0.5 * last).clip(env.action_space.low, env.action_space.high)
        observation, *_ = env.step(waiting)
        last, waiting = own if observes == "own" else waiting, own
        poses.append(env.data.qpos.copy())
    return np.array(poses)


def test_under_a_delay_a_policy_observes_its_own_action():
    """As in mjlab, Isaac Lab and on a robot; in a world of several lanes and in a wrapped environment."""
    world, box = make_world(str(ANT), [0, 1]), VelocityCommandEnv(str(ANT)).action_space
    disturbed, poses = DisturbedWorld(world, parse_disturbances(["action_delay:1"]), [0, 1]), []
    wrapped = TimeToGoObservation(Disturb(VelocityCommandEnv(str(ANT)), ["action_delay:1"]), Geometric(5), Constant(9))
    seen, (alone, _), walked = disturbed.reset(), wrapped.reset(seed=1), []
    for _ in range(40):
        seen = disturbed.step((act(seen) + 0.5 * seen[:, ACTIONS]).clip(box.low, box.high)).observations
        alone, *_ = wrapped.step((act(alone[:-5]) + 0.5 * alone[ACTIONS]).clip(box.low, box.high))
        poses.append(world.environments[1].unwrapped.data.qpos.copy())
        walked.append(wrapped.unwrapped.data.qpos.copy())
    own, applied = delayed_walk("own"), delayed_walk("applied")
    assert np.array_equal(poses, own)
    assert np.array_equal(walked, own)
    assert np.abs(own - applied).max() > 0.01
    world.close()


@pytest.mark.parametrize("text", ["action_noise:0.2", "lag:0.6"])
def test_under_noise_and_lag_too(text):
    env, action = Disturb(VelocityCommandEnv(str(ANT)), [text], 0), np.linspace(-0.5, 0.5, 8)
    env.reset(seed=0)
    assert (env.step(action)[0][ACTIONS] == action).all()
    assert not np.isclose(env.unwrapped.data.ctrl, env.unwrapped.contract.values("default_pose") + 0.3 * action).any()
    assert (env.unwrapped.step(0.5 * action)[0][ACTIONS] == 0.5 * action).all()  # undisturbed again


def test_a_wrapper_that_changes_actions_changes_what_is_observed():
    """Below it the policy's own action would have the wrong unit."""
    seen = []
    for text in ("action_noise:0", "push:0"):
        env = Disturb(gymnasium.wrappers.RescaleAction(VelocityCommandEnv(str(ANT)), -0.01, 0.01), [text], 0)
        env.reset(seed=0)
        seen.append(env.step(np.full(8, 0.005, np.float32))[0][ACTIONS] / env.unwrapped.action_space.high)
    assert np.greater(seen, 0.4).all()


def test_the_identity_of_a_robot_covers_contract_and_model(tmp_path):
    text = ANT.read_text()
    other = tmp_path / "other.yaml"
    digests = set()
    for changed in (text, text.replace("60.0", "61.0"), text + "# a comment\n"):
        other.write_text(changed)
        digests.add(sources(str(other))["robot"])
    assert len(digests) == 2, "a comment changes no result"
    other.write_text(text)
    assert sources(str(other)) == sources(str(ANT))
