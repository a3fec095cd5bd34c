"""`robot init`: what a draft takes from a model, from metadata and a deploy.yaml, and what it leaves to fill in."""

import mujoco
import numpy as np
import pytest
import yaml
from msgspec.structs import fields

from perdure.__main__ import main
from perdure.errors import PerdureError
from perdure.robots import Contract, read_contract
from perdure.robots.contract import HeldJoints, RandomCommands, Term, field_texts
from perdure.robots.draft import MARK, draft
from perdure.robots.readers import parse_yaml
from tests.robots.test_contract import MJLAB

MODEL = """<mujoco><option timestep="0.005"/><worldbody><body pos="0 0 1"><freejoint/><geom size=".1"/>
<body><joint name="hip" axis="0 1 0" range="-1 1" armature="0.02"/><geom size=".1" pos="0 0 -.3"/>
<body><joint name="knee" axis="0 1 0" range="-1 1"/><geom size=".1" pos="0 0 -.6"/></body></body></body></worldbody>
{actuators}<keyframe><key qpos="0 0 1 1 0 0 0 0.25 -0.5"/></keyframe></mujoco>"""
SERVOS = """<actuator><position joint="hip" kp="30" kv="2" forcerange="-9 9"/><position joint="knee" kp="40" kv="3"/>
</actuator>"""
MOTORS = """<actuator><motor joint="hip" gear="4" ctrlrange="-2 2"/><motor joint="knee" gear="4"/></actuator>"""
DEPLOY = """
joint_ids_map: [1, 0]
step_dt: 0.02
stiffness: [10.0, 11.0]
damping: [1.0, 2.0]
default_joint_pos: [0.3, 0.4]
actions:
  JointPositionAction: {scale: [0.5, 0.6], joint_ids: !!python/object/apply:builtins.slice [null, null, null]}
observations:
  base_ang_vel: {clip: null, scale: [0.2, 0.2, 0.2], history_length: 5}
  last_action: {clip: [-1.0, 1.0], scale: null, history_length: 1}
"""


@pytest.fixture
def robot(tmp_path):
    def written(actuators=SERVOS):
        path = tmp_path / "robot.xml"
        path.write_text(MODEL.format(actuators=actuators))
        return path

    return written


def policy_with(folder, notes):
    onnx = pytest.importorskip("onnx")
    from onnx import TensorProto, helper

    value = helper.make_tensor_value_info
    sizes = {"obs": TensorProto.FLOAT, "actions": TensorProto.FLOAT}
    ends = [value(name, kind, [1, 2]) for name, kind in sizes.items()]
    graph = helper.make_graph([helper.make_node("Identity", ["obs"], ["actions"])], "policy", ends[:1], ends[1:])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, notes)
    folder.mkdir(exist_ok=True)
    onnx.save(model, folder / "policy.onnx")
    return folder / "policy.onnx"


def test_gains_of_a_geared_servo_are_those_that_the_simulator_applies(robot):
    servo = '<position joint="{}" gear="4" kp="30" kv="2"/>'
    path = robot("<actuator>" + servo.format("hip") + servo.format("knee") + "</actuator>")
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.joint("hip").qpos = 0.1
    mujoco.mj_forward(model, data)
    torque = data.joint("hip").qfrc_actuator[0]
    data.joint("hip").qvel = 1.0
    mujoco.mj_forward(model, data)
    damped = data.joint("hip").qfrc_actuator[0]
    found = yaml.safe_load(draft(path, None, path.parent))
    assert found["stiffness"][0] == pytest.approx(-torque / 0.1)
    assert found["damping"][0] == pytest.approx(torque - damped)


def test_a_model_gives_joints_pose_gains_and_steps_and_the_rest_is_marked(robot, tmp_path):
    text = draft(robot(), None, tmp_path)
    values = yaml.safe_load(text)
    assert (values["model"], values["joints"]) == ("robot.xml", ["hip", "knee"])
    assert values["default_pose"] == [0.25, -0.5], "of the keyframe"
    assert (values["stiffness"], values["damping"]) == ([30.0, 40.0], [2.0, 3.0])
    assert (values["time_step"], values["decimation"]) == (0.005, 4)
    assert "effort_limit: [9.0, 0.0]" in text
    assert "for 1 of 2 joints, such as knee" in text
    marked = [line for line in text.splitlines() if line.startswith(f"# {MARK}")]
    assert len(marked) == 4, "action_scale, observations, effort_limit and armature"


def test_the_check_names_what_is_marked_and_reads_the_completed_draft(robot, tmp_path):
    path = tmp_path / "robot.yaml"
    path.write_text(draft(robot(MOTORS), None, tmp_path))
    with pytest.raises(PerdureError, match="stiffness, damping, action_scale, observations missing"):
        read_contract(path)
    text = path.read_text()
    assert "effort_limit: [8.0, 0.0]" in text
    for name in ("stiffness", "damping", "action_scale", "observations"):
        text = text.replace(f"# {name}: ", f"{name}: ")
    path.write_text(text)
    contract = read_contract(path)
    assert contract.values("stiffness").tolist() == [20.0, 20.0]
    assert contract.observation_size == 3 + 3 + 3 + 3 * 2


def test_metadata_of_the_policy_come_first(robot, tmp_path):
    values = yaml.safe_load(draft(robot(), policy_with(tmp_path, MJLAB), tmp_path))
    assert (values["stiffness"], values["default_pose"], values["action_scale"]) == ([20.0, 30.0], [0.1, -0.2], 0.25)
    path = tmp_path / "robot.yaml"
    path.write_text(yaml.safe_dump(values))
    assert [term.name for term in read_contract(path).terms] == ["base_ang_vel", "joint_pos", "actions"]
    assert read_contract(path).terms[1].clip == (-1.0, 1.0)


def test_a_deploy_file_beside_the_policy_is_read_and_its_code_is_not_run(robot, tmp_path):
    """As unitree_rl_lab writes it: gains by motor, pose and scale by joint of the policy."""
    policy = policy_with(tmp_path / "exported", {})
    (tmp_path / "params").mkdir()
    (tmp_path / "params" / "deploy.yaml").write_text(DEPLOY)
    path = tmp_path / "robot.yaml"
    main(["robot", "init", str(robot()), "--policy", str(policy), "--out", str(path)])
    contract = read_contract(path)
    assert contract.joints == ("knee", "hip")
    assert [contract.values(name).tolist() for name in ("default_pose", "stiffness", "damping", "action_scale")] == [
        *([0.3, 0.4], [11.0, 10.0], [2.0, 1.0], [0.5, 0.6])
    ]
    names = [(term.name, term.scale, term.history) for term in contract.terms]
    assert names == [("base_ang_vel", 0.2, 5), ("actions", 1.0, 1)]
    assert contract.terms[1].clip == (-1.0, 1.0)
    (tmp_path / "params" / "deploy.yaml").write_text(DEPLOY.replace("[1, 0]", "[7, 0]"))
    with pytest.raises(PerdureError, match="Unitree"):
        draft(robot(), policy, tmp_path)


def test_tags_of_python_objects_do_nothing(tmp_path):
    text = f"a: !!python/object/apply:os.system ['touch {tmp_path}/trace']\nb: !!python/name:os.system ''"
    assert parse_yaml(text.encode(), foreign=True)["a"] == [f"touch {tmp_path}/trace"]
    assert not (tmp_path / "trace").exists()


def test_a_model_that_is_none_is_refused(tmp_path):
    (tmp_path / "a.xml").write_text("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    (tmp_path / "b.xml").write_text("no")
    for name, message in (("a.xml", "no joint"), ("b.xml", "b.xml"), ("c.xml", "no model")):
        with pytest.raises(PerdureError, match=message):
            draft(tmp_path / name, None, tmp_path)


@pytest.mark.parametrize("kind", [Contract, Term, HeldJoints, RandomCommands])
def test_every_field_is_explained(kind):
    assert list(field_texts(kind)) == [field.name for field in fields(kind)]
    assert np.all([len(text) > 10 for text in field_texts(kind).values()])
