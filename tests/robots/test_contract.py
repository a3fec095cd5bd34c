"""Contracts: what a YAML file or a policy's metadata say, and what is refused."""

import math

import numpy as np
import pytest
import yaml
from msgspec.structs import replace

from perdure.errors import PerdureError
from perdure.robots import read_contract
from perdure.robots.readers import from_metadata
from tests.robots.conftest import ANT

MJLAB = {
    "run_path": "none",
    "joint_names": "hip,knee",
    "joint_stiffness": "20.000,30.000",
    "joint_damping": "0.500,0.600",
    "default_joint_pos": "0.100,-0.200",
    "observation_names": "base_ang_vel,joint_pos,actions",
    "observation_terms_scale": "0.250,1.000;2.000,1.000",
    "observation_terms_clip": "-inf;inf,-1.000;1.000,-inf;inf",
    "observation_terms_history_length": "3.000,0.000,1.000",
    "action_scale": "0.250",
}
"""As mjlab 1.6 writes it (`mjlab.rl.exporter_utils`)."""


@pytest.fixture
def write(tmp_path):
    def written(text="", **changes):
        values = {**yaml.safe_load(ANT.read_text()), **changes}
        path = tmp_path / "robot.yaml"
        path.write_text(text or yaml.safe_dump({key: value for key, value in values.items() if value is not None}))
        return path

    return written


def test_values_of_joints_by_number_list_and_pattern(write):
    contract = read_contract(
        write(stiffness=7.0, damping=list(range(8)), effort_limit={"hip_.": 1, "ankle_.": 2}, history=4)
    )
    assert contract.values("stiffness").tolist() == [7.0] * 8
    assert contract.values("damping").tolist() == list(range(8))
    assert contract.values("effort_limit").tolist() == [1.0, 2.0] * 4
    assert contract.values("default_pose")[[1, 3, 5, 7]].tolist() == [0.9, -0.9, -0.9, 0.9]
    assert [term.history for term in contract.terms] == [4, 4, 4, 4, 4, 4, 6]
    assert contract.observation_size == 4 * (3 + 3 + 3 + 8 + 8 + 8) + 6 * 2
    assert contract.model.endswith("gymnasium/envs/mujoco/assets/ant.xml")


def test_names_of_other_projects_mean_the_same_terms(write):
    names = ["velocity_commands", "dof_pos", "joint_vel_rel", "last_action"]
    found = [term.name for term in read_contract(write(observations=names)).terms]
    assert found == ["command", "joint_pos", "joint_vel", "actions"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"stiffness": None, "time_step": None}, "stiffness, time_step missing"),
        ({"joints": None}, "joints missing: .* the model's joints are hip_1, ankle_1, hip_2, ankle_2"),
        ({"joints": None, "model": "nowhere.xml"}, "model: .*nowhere.xml"),
        ({"damping": [1.0, 2.0]}, "damping has 2 values for 8 joints"),
        ({"damping": {"hip_.": 1.0}}, "one pattern must match each joint; 0 match ankle_1"),
        ({"damping": {"(": 1.0}}, "no regular expression"),
        ({"damping": "x"}, "damping must be"),
        ({"joints": ["hip_1", "hip_1"]}, "joints must differ"),
        ({"observations": ["base_angvel"]}, "no observation term 'base_angvel'.*did you mean 'base_ang_vel'"),
        ({"observations": [{"name": "command", "scale": [1.0]}]}, "command has 3 numbers, but 1 scales"),
        ({"history_layout": "by step"}, "needs the same history"),
        ({"script": [[1, 0, 0, 0]]}, "script must begin at 0"),
        ({"decimation": 0}, "decimation must be"),
        ({"gains": 1.0}, "no field 'gains'; the fields are model, joints"),
        ({"armatur": 1.0}, "no field 'armatur'; did you mean 'armature'"),
        ({"observations": [{"name": "command", "scales": 1.0}]}, r"observations\[0\]: .*did you mean 'scale'"),
        ({"random": {"low": [0, 0, 0], "height": [1, 0, 0]}}, "random: there is no field 'height'"),
        ({"model": "package://no-such-package/a.xml"}, "no Python package no_such_package"),
    ],
)
def test_what_does_not_fit_is_refused(write, changes, message):
    with pytest.raises(PerdureError, match=message):
        read_contract(write(**changes))


@pytest.mark.parametrize("text", ["a: &x [1]\nb: [*x, *x]", "- 1", "a: [", "!!python/object/apply:os.getcwd []"])
def test_a_file_that_is_no_table_is_refused(write, text):
    with pytest.raises(PerdureError, match=r"robot\.yaml: (aliases|it must hold|it is no YAML)"):
        read_contract(write(text))


def test_metadata_of_mjlab():
    found = from_metadata(MJLAB)
    assert found["joints"] == ["hip", "knee"]
    assert (found["stiffness"], found["damping"]) == ([20.0, 30.0], [0.5, 0.6])
    assert (found["default_pose"], found["action_scale"]) == ([0.1, -0.2], 0.25)
    unbounded = [-math.inf, math.inf]
    assert found["observations"] == [
        {"name": "base_ang_vel", "scale": 0.25, "clip": unbounded, "history": 3},
        {"name": "joint_pos", "scale": [1.0, 2.0], "clip": [-1.0, 1.0], "history": 0},
        {"name": "actions", "scale": 1.0, "clip": unbounded, "history": 1},
    ]


def test_metadata_of_holosoma():
    assert from_metadata({"dof_names": '["a", "b"]', "kp": "[1.0, 2.0]", "kd": "[3, 4]", "other": "x"}) == {
        **{"joints": ["a", "b"], "stiffness": [1.0, 2.0], "damping": [3.0, 4.0]},
    }


def test_metadata_fill_what_the_file_leaves_out(write, tmp_path, policy_file):
    import onnx
    from onnx import helper

    model = onnx.load(policy_file)
    helper.set_model_props(model, {"joint_stiffness": ",".join(map(str, range(8))), "joint_damping": "bad"})
    onnx.save(model, tmp_path / "policy.onnx")
    contract = None
    with pytest.raises(PerdureError, match="metadata cannot be read"):
        read_contract(write(stiffness=None, metadata="policy.onnx"))
    helper.set_model_props(model, {"joint_stiffness": ",".join(map(str, range(8))), "joint_damping": "9"})
    onnx.save(model, tmp_path / "policy.onnx")
    contract = read_contract(write(stiffness=None, metadata="policy.onnx"))
    assert contract.values("stiffness").tolist() == list(range(8))
    assert np.allclose(contract.values("damping"), 60.0)  # the file comes first


def test_contracts_are_compared_by_value(ant):
    assert read_contract(ANT) == ant
    assert hash(replace(ant, decimation=7)) != hash(ant)
