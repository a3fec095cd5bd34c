"""Readers of deployment files, against what Unitree and Isaac Lab write for the same robot."""

import re

import numpy as np
import pytest
import yaml

from perdure.__main__ import main
from perdure.envs import task_of_environment, task_spec, with_model
from perdure.errors import PerdureError
from perdure.robots import read_contract
from perdure.robots.draft import MARK, draft
from perdure.robots.world import sources
from tests.robots.test_draft import policy_with

LEG = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
ARM = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_roll")
LEGS = [[f"{side}_{part}_joint" for part in LEG] for side in ("left", "right")]
ARMS = [[f"{side}_{part}_joint" for part in ARM] for side in ("left", "right")]
G1 = [*LEGS[0], *LEGS[1], "waist_yaw_joint", *ARMS[0], *ARMS[1]]
"""The 23 joints of a G1 without wrist and waist motors, in the order of its MJCF."""


def chain(joints, inside=""):
    """MJCF of bodies inside each other, one for each joint."""
    for joint in reversed(joints):
        body = f"<joint name='{joint}' axis='0 1 0' armature='.01'/><geom size='.03' contype='0'/>{inside}"
        inside = f"<body pos='0 0 -.1'>{body}</body>"
    return inside


def write_g1(folder, chains):
    text = f"<worldbody><body name='pelvis' pos='0 0 1'><freejoint/><geom size='.1'/>{chains}</body></worldbody>"
    (folder / "g1.xml").write_text(f"<mujoco><option timestep='0.005'/>{text}</mujoco>")
    return folder / "g1.xml"


@pytest.fixture
def g1(tmp_path):
    arms = chain(ARMS[0]) + chain(ARMS[1])
    return write_g1(tmp_path, chain(LEGS[0]) + chain(LEGS[1]) + chain(["waist_yaw_joint"], arms))


# What unitree_rl_lab exported for one training run of a G1 with 23 joints (scripts/stability/logs/2025-08-27_16-50-30
# in its repository, Apache-2.0): gains by motor with gaps for the missing wrists, the rest by joint of the policy.
MAP = [0, 6, 12, 1, 7, 15, 22, 2, 8, 16, 23, 3, 9, 17, 24, 4, 10, 18, 25, 5, 11, 19, 26]
POSE = [-0.1, -0.1, 0, 0, 0, 0.3, 0.3, 0, 0, 0.25, -0.25, 0.3, 0.3, 0, 0, -0.2, -0.2, 0.97, 0.97, 0, 0, 0.15, -0.15]
LEG_GAINS = [100.0, 100.0, 100.0, 150.0, 40.0, 40.0], [2.0, 2.0, 2.0, 4.0, 10.0, 10.0]
DEPLOY = {
    "joint_ids_map": MAP,
    "step_dt": 0.02,
    "stiffness": [*LEG_GAINS[0] * 2, 200.0, 0.0, 0.0, *[40.0] * 5, 0.0, 0.0, *[40.0] * 5],
    "damping": [*LEG_GAINS[1] * 2, 5.0, 0.0, 0.0, *[10.0] * 5, 0.0, 0.0, *[10.0] * 5],
    "default_joint_pos": POSE,
    "commands": {"base_velocity": {"ranges": {"lin_vel_x": [-0.5, 1.0]}}},
    "actions": {"JointPositionAction": {"clip": None, "scale": [0.25] * 23, "offset": POSE, "joint_ids": None}},
    "observations": {
        name: {"params": {}, "clip": None, "scale": scale, "history_length": 5}
        for name, scale in [
            ("base_ang_vel", [0.2] * 3),
            ("projected_gravity", [1.0] * 3),
            ("velocity_commands", [1.0] * 3),
            ("joint_pos_rel", [1.0] * 23),
            ("joint_vel_rel", [0.05] * 23),
            ("last_action", [1.0] * 23),
        ]
    },
}
# The same run's env.yaml, as far as a contract needs it, with the tags that Isaac Lab writes.
ENV = """
sim: {dt: 0.005, gravity: !!python/tuple [0.0, 0.0, -9.81]}
decimation: 4
scene:
  num_envs: 4096
  robot:
    init_state:
      joint_pos: {left_hip_pitch_joint: -0.1, right_hip_pitch_joint: -0.1, .*_knee_joint: 0.3,
        .*_ankle_pitch_joint: -0.2, .*_shoulder_pitch_joint: 0.3, left_shoulder_roll_joint: 0.25,
        right_shoulder_roll_joint: -0.25, .*_elbow_joint: 0.97, left_wrist_roll_joint: 0.15,
        right_wrist_roll_joint: -0.15}
    actuators:
      N7520-14.3: {class_type: 'isaaclab.actuators.actuator_pd:ImplicitActuator',
        joint_names_expr: [.*_hip_pitch_.*, .*_hip_yaw_.*, waist_yaw_joint], effort_limit: null, effort_limit_sim: 88,
        stiffness: {.*_hip_.*: 100.0, waist_yaw_joint: 200.0}, damping: {.*_hip_.*: 2.0, waist_yaw_joint: 5.0},
        armature: 0.01, friction: null}
      N7520-22.5: {class_type: 'isaaclab.actuators.actuator_pd:ImplicitActuator',
        joint_names_expr: [.*_hip_roll_.*, .*_knee_.*], effort_limit_sim: 139,
        stiffness: {.*_hip_roll_.*: 100.0, .*_knee_.*: 150.0}, damping: {.*_hip_roll_.*: 2.0, .*_knee_.*: 4.0},
        armature: 0.01}
      N5020-16: {class_type: 'isaaclab.actuators.actuator_pd:ImplicitActuator',
        joint_names_expr: [.*_shoulder_.*, .*_elbow_.*, .*_wrist_roll_.*], effort_limit_sim: 25, stiffness: 40.0,
        damping: 10.0, armature: 0.01}
      N5020-16-parallel: {class_type: 'isaaclab.actuators.actuator_pd:ImplicitActuator',
        joint_names_expr: [.*ankle.*], effort_limit_sim: 35, stiffness: 40.0, damping: 10.0, armature: 0.01}
observations:
  policy:
    concatenate_terms: true
    history_length: 5
    base_ang_vel: {func: 'isaaclab.envs.mdp.observations:base_ang_vel', params: {}, clip: null, scale: 0.2,
      history_length: 0, noise: {n_min: -0.2, n_max: 0.2}}
    projected_gravity: {func: 'isaaclab.envs.mdp.observations:projected_gravity', clip: null, scale: null}
    velocity_commands: {func: 'isaaclab.envs.mdp.observations:generated_commands', scale: null}
    joint_pos_rel: {func: 'isaaclab.envs.mdp.observations:joint_pos_rel', params: {}, scale: null}
    joint_vel_rel: {func: 'isaaclab.envs.mdp.observations:joint_vel_rel', params: {}, scale: 0.05}
    last_action: {func: 'isaaclab.envs.mdp.observations:last_action', scale: null}
  critic:
    height_scan: {func: 'isaaclab.envs.mdp.observations:height_scan'}
actions:
  JointPositionAction: {class_type: 'isaaclab.envs.mdp.actions.joint_actions:JointPositionAction', clip: null,
    joint_names: [.*], scale: 0.25, preserve_order: false, use_default_offset: true}
events:
  reset: {joint_ids: !!python/object/apply:builtins.slice [null, null, null]}
"""


def write(folder, name, values):
    (folder / name).write_text(values if isinstance(values, str) else yaml.safe_dump(values, sort_keys=False))
    return folder / name


def test_what_unitree_and_isaac_lab_write_of_one_robot_is_one_contract(g1, tmp_path):
    """The order of joints, too: a map of motors in one file, breadth first in the tree in the other."""
    theirs = read_contract(f"{write(tmp_path, 'deploy.yaml', DEPLOY)},model={g1}")
    ours = read_contract(f"{write(tmp_path, 'env.yaml', ENV)},model={g1}")
    assert theirs.joints == ours.joints
    assert ours.joints[:7:3] == ("left_hip_pitch_joint", "left_hip_roll_joint", "right_shoulder_pitch_joint")
    for name in ("default_pose", "stiffness", "damping", "action_scale"):
        assert np.array_equal(theirs.values(name), ours.values(name)), name
    assert (theirs.terms, theirs.time_step, theirs.decimation) == (ours.terms, 0.005, 4)
    assert ours.terms[4].scale == 0.05
    assert ours.observation_size == 5 * (9 + 3 * 23)
    limits = dict(zip(ours.joints, ours.values("effort_limit"), strict=True))
    assert (limits["left_knee_joint"], limits["right_ankle_roll_joint"], limits["waist_yaw_joint"]) == (139, 35, 88)


def test_motors_of_a_quadruped_begin_with_the_right_leg(tmp_path):
    """As unitree_rl_mjlab writes it for a Go2, whose model begins with the left leg."""
    legs = [[f"{leg}_{part}_joint" for part in ("hip", "thigh", "calf")] for leg in ("FL", "FR", "RL", "RR")]
    model = write_g1(tmp_path, "".join(map(chain, legs)))
    pose = [-0.1, 0.9, -1.8, 0.1, 0.9, -1.8] * 2
    given = {
        **DEPLOY,
        "joint_ids_map": [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8],
        "stiffness": [20, 21, 40, 22, 20, 40] * 2,
        "damping": [1, 1, 2] * 4,
        "default_joint_pos": pose,
        "actions": {"JointPositionAction": {"scale": [0.5] * 12, "offset": pose}},
        "observations": {"last_action": {"scale": [1.0] * 12, "history_length": 1}},
    }
    contract = read_contract(f"{write(tmp_path, 'deploy.yaml', given)},model={model}")
    assert list(contract.joints) == [joint for leg in legs for joint in leg]
    assert contract.values("stiffness")[:5].tolist() == [22, 20, 40, 20, 21]


GYM = {
    "policy_path": "{LEGGED_GYM_ROOT_DIR}/deploy/pre_train/g1/motion.pt",
    "xml_path": "{LEGGED_GYM_ROOT_DIR}/g1.xml",
    "simulation_dt": 0.002,
    "control_decimation": 10,
    "kps": LEG_GAINS[0] * 2,
    "kds": LEG_GAINS[1] * 2,
    "default_angles": [-0.1, 0.0, 0.0, 0.3, -0.2, 0.0] * 2,
    "ang_vel_scale": 0.25,
    "dof_pos_scale": 1.0,
    "dof_vel_scale": 0.05,
    "action_scale": 0.25,
    "cmd_scale": [2.0, 2.0, 0.25],
    "num_actions": 12,
    "num_obs": 47,
    "cmd_init": [0.5, 0, 0],
}
"""As unitree_rl_gym's deploy/deploy_mujoco/configs/g1.yaml (BSD-3-Clause); its model is one of the legs."""


def test_a_config_of_legged_gym_names_its_model_and_has_a_gait_clock(tmp_path):
    write_g1(tmp_path, chain(LEGS[0]) + chain(LEGS[1]))
    folder = tmp_path / "deploy" / "configs"
    folder.mkdir(parents=True)
    contract = read_contract(write(folder, "g1.yaml", GYM))
    assert contract.joints == (*LEGS[0], *LEGS[1])
    assert (contract.time_step, contract.decimation, contract.observation_size) == (0.002, 10, 47)
    assert (contract.terms[2].scale, contract.terms[-1].name) == ((2.0, 2.0, 0.25), "gait_phase")
    assert (contract.gait_period, contract.gait_while_standing) == (0.8, "run")


def test_joints_that_the_script_holds_are_held(g1, tmp_path):
    """As in unitree_rl_gym's deploy/deploy_real/configs/g1.yaml, with a waist and arms of a smaller robot."""
    real = {name: value for name, value in GYM.items() if name not in ("xml_path", "simulation_dt")}
    del real["control_decimation"]
    real |= {"control_dt": 0.02, "msg_type": "hg", "leg_joint2motor_idx": list(range(12)), "arm_waist_kds": [3, 2]}
    real |= {"arm_waist_joint2motor_idx": [12, 13], "arm_waist_target": [0.1, 0.2], "arm_waist_kps": [300, 100]}
    contract = read_contract(f"{write(tmp_path, 'real.yaml', real)},model={g1}")
    assert contract.decimation == 4
    assert contract.held[0].matched(G1) == {G1[12]: (0.1, 300.0, 3.0), G1[13]: (0.2, 100.0, 2.0)}
    with pytest.raises(PerdureError, match="joints: motors of Unitree's older robots"):
        read_contract(f"{write(tmp_path, 'real.yaml', {**real, 'msg_type': 'go'})},model={g1}")


ACTUATOR = "class_type: 'isaaclab.actuators.actuator_net:ActuatorNetMLP', joint_names_expr: [.*ankle.*], friction: 0"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("func: 'isaaclab.envs.mdp.observations:projected_gravity'", "func: 'm:height_scan'", "observations: .*height"),
        ("'isaaclab.envs.mdp.observations:joint_pos_rel', params: {}", "'m:joint_pos_rel', params: {asset_cfg: "
         "{joint_names: [.*knee.*]}}", "observations: joint_pos_rel observes some"),
        ("JointPositionAction'", "JointEffortAction'", "action_scale: actions are JointEffortAction"),
        ("clip: null,\n    joint", "clip: {.*: [-1, 1]},\n    joint", "action_clip: joint targets are clipped"),
        ("joint_names_expr: [.*ankle.*],", "joint_names_expr: [.*ankle_pitch.*],", "stiffness: no actuators say it"),
        ("joint_names_expr: [.*ankle.*],", "joint_names_expr: [.*ankle.*], max_delay: 4,", "action_delay: .*0 to 4"),
        ("joint_names: [.*], scale", "joint_names: [toes], scale", "joints: no joint of the model matches toes"),
        ("  policy:\n", "  actor:\n", "observations: there is no group"),
    ],
)  # fmt: skip
def test_what_a_contract_cannot_hold_is_named_with_the_command_that_writes_the_rest(g1, tmp_path, old, new, message):
    assert old in ENV
    path = write(tmp_path, "env.yaml", ENV.replace(old, new))
    with pytest.raises(PerdureError, match=message) as raised:
        read_contract(f"{path},model={g1}")
    assert f"perdure robot init {path} --model {g1}" in str(raised.value)
    text = draft(g1, None, tmp_path, path)
    assert re.search(f"{MARK}.*{message.partition(': ')[2]}", text), "the draft marks it"
    assert yaml.safe_load(text)["decimation"] == 4


@pytest.mark.parametrize(
    ("old", "new"),
    [("scene:", "scene: {}\nother:"), ("scale: 0.25,", "scale: {(: 1.0},"), ("decimation: 4", "decimation: [4]")],
)
def test_a_file_of_another_form_is_refused(g1, tmp_path, old, new):
    assert old in ENV
    with pytest.raises(PerdureError, match="not as Isaac Lab writes it"):
        read_contract(f"{write(tmp_path, 'env.yaml', ENV.replace(old, new))},model={g1}")


def test_joints_without_an_action_are_held_by_their_actuators(g1, tmp_path):
    text = ENV.replace("joint_names: [.*], scale", "joint_names: [.*hip.*, .*knee.*, .*ankle.*], scale")
    contract = read_contract(f"{write(tmp_path, 'env.yaml', text)},model={g1}")
    assert sorted(contract.joints) == sorted([*LEGS[0], *LEGS[1]])
    held = contract.held[0].matched(G1)
    assert held["left_elbow_joint"] == (0.97, 40.0, 10.0)
    assert len(held) == 11


def test_a_motor_of_isaac_lab_has_a_speed_limit(g1, tmp_path):
    old = "ImplicitActuator',\n        joint_names_expr: [.*ankle.*], effort_limit_sim: 35,"
    text = ENV.replace("pd:ImplicitActuator", "pd:DCMotor").replace("effort_limit_sim", "saturation_effort: 200, "
        "velocity_limit: 30.0, effort_limit")  # fmt: skip
    assert old in ENV
    contract = read_contract(f"{write(tmp_path, 'env.yaml', text)},model={g1}")
    assert set(contract.values("velocity_limit")) == {30.0}
    assert set(contract.values("saturation_effort")) == {200.0}
    assert contract.values("effort_limit").max() == 139.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"observations": {"height_map": {"history_length": 1}}}, "observations: there is no term height_map"),
        (
            {"actions": {"JointPositionAction": {"scale": 1.0, "joint_ids": [0, 1]}}},
            "joints: actions drive 2 of the 23",
        ),
        ({"actions": {"JointVelocityAction": {}}}, "action_scale: actions are JointVelocityAction"),
        ({"default_joint_pos": [0.0] * 23}, "default_pose: the offset"),
        ({"stiffness": None}, "not as Unitree"),
        ({"observations": {"a": DEPLOY["observations"], "b": DEPLOY["observations"]}}, "several groups"),
    ],
)
def test_what_a_deploy_file_does_not_say_is_named(g1, tmp_path, changes, message):
    with pytest.raises(PerdureError, match=message):
        read_contract(f"{write(tmp_path, 'deploy.yaml', {**DEPLOY, **changes})},model={g1}")


def test_options_of_the_observations(g1, tmp_path):
    terms = {"gait_phase": {"params": {"period": 0.6}, "history_length": 2}, **DEPLOY["observations"]}
    terms["base_ang_vel"] = {"scale": [0.5] * 3, "clip": [-3.0, 3.0], "history_length": 2}
    group = {name: {**each, "history_length": 2} for name, each in terms.items()}
    changed = {**DEPLOY, "observations": {"obs": {"use_gym_history": True, "scale_first": True, **group}}}
    contract = read_contract(f"{write(tmp_path, 'deploy.yaml', changed)},model={g1}")
    assert contract.history_layout == "by step"
    assert (contract.gait_period, contract.gait_offsets) == (0.6, (0.0,))
    assert contract.terms[1].clip == (-6.0, 6.0), "the limits of the scaled values"


def test_the_command_line_takes_the_model_beside_the_file(g1, tmp_path, capsys):
    deploy = write(tmp_path, "deploy.yaml", DEPLOY)
    with pytest.raises(PerdureError, match="add --model"):
        read_contract(deploy)
    main(["robot", "check", str(deploy), "--model", str(g1)])
    assert capsys.readouterr().out.startswith("23 joints, 390 observations")
    main(["robot", "init", str(deploy), "--model", str(g1), "--out", str(tmp_path / "robot.yaml")])
    assert read_contract(tmp_path / "robot.yaml") == read_contract(f"{deploy},model={g1}")


def test_env_beside_deploy_adds_limits_to_the_draft(g1, tmp_path):
    write(tmp_path, "deploy.yaml", DEPLOY)
    write(tmp_path, "env.yaml", ENV)
    values = yaml.safe_load(draft(g1, policy_with(tmp_path / "exported", {}), tmp_path))
    assert "effort_limit" not in values
    for name in ("deploy.yaml", "env.yaml"):
        (tmp_path / "params").mkdir(exist_ok=True)
        (tmp_path / name).rename(tmp_path / "params" / name)
    values = yaml.safe_load(draft(g1, tmp_path / "exported" / "policy.onnx", tmp_path))
    assert max(values["effort_limit"]) == 139.0


LEAPP = {
    "models": {
        "policy": {
            "inputs": [{"name": "joint_pos", "shape": [1, 2], "kind": "state/joint/position"}],
            "outputs": [
                {"name": "target", "kind": "target/joint/position", "element_names": [[LEGS[0][3], LEGS[1][3]]]},
                {"name": "kp_gains", "kind": "kp"},
            ],
        }
    },
    "pipeline": {"inputs": {"policy": ["joint_pos"]}, "outputs": {"policy": ["target", "kp_gains"]}},
}
"""In the form of LEAPP's documentation of semantic annotations."""


def test_a_graph_of_leapp_gives_joints_and_the_rest_is_named(g1, tmp_path):
    path = write(tmp_path, "graph.yaml", LEAPP)
    with pytest.raises(PerdureError, match=r"observations: .*joint_pos \(state/joint/position\)"):
        read_contract(f"{path},model={g1}")
    assert yaml.safe_load(draft(g1, None, tmp_path, path))["joints"] == [LEGS[0][3], LEGS[1][3]]


def test_a_file_with_a_model_is_a_task(g1, tmp_path):
    name = with_model(str(write(tmp_path, "deploy.yaml", DEPLOY)), str(g1))
    assert task_of_environment(name) == name
    assert task_spec(name).observation_size == 390
    path = tmp_path / "robot.yaml"
    path.write_text(draft(g1, None, tmp_path, tmp_path / "deploy.yaml"))
    assert sources(name) == sources(str(path)), "one robot, whichever file it is read from"
    with pytest.raises(PerdureError, match="--model is for an --env that is a file"):
        with_model("Hopper-v5", str(g1))
