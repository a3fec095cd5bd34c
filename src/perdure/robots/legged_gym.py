"""Reader of the YAML files of deploy scripts in the manner of legged_gym: unitree_rl_gym's deploy/*/configs.

The file has gains, pose, scales and sizes. The observations are in the scripts, all of which write: angular velocity,
gravity, command, joint positions, joint velocities, last action, and in the robots that walk with a gait clock sine and
cosine of a clock of 0.8 s. Source: github.com/unitreerobotics/unitree_rl_gym, folder deploy (BSD-3-Clause).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from perdure.robots.deployment import as_written_by, foreign_yaml, numbers, observation, one_or_all, top_level_names
from perdure.robots.readers import DeploymentReader, Reading

CLOCK = 0.8
"""Period of the clock in the deploy scripts [s]."""
WITHOUT_JOINTS = 9
"""Numbers of an observation that are not of joints: angular velocity, gravity and command."""


class LeggedGymDeployment(DeploymentReader):
    """See `words`."""

    name = "legged_gym"
    words = "YAML files of deploy scripts in the manner of legged_gym (unitree_rl_gym)"
    suffixes = (".yaml", ".yml")

    def recognizes(self, path: Path) -> bool:
        """See `ContractReader.recognizes`."""
        return {"kps", "kds", "default_angles", "action_scale", "num_obs"} <= top_level_names(path)

    def named_model(self, path: Path) -> Path | None:
        """See `DeploymentReader.named_model`; `{LEGGED_GYM_ROOT_DIR}` is a folder above the file."""
        named = re.sub(r"^\{\w+\}/", "", str(foreign_yaml(path).get("xml_path", "")))
        for folder in path.resolve().parents:
            if named and (folder / named).is_file():
                return folder / named
        return None

    def reading(self, path: Path, robot: Mapping[str, Any]) -> Reading:
        """See `DeploymentReader.reading`."""
        with as_written_by("unitree_rl_gym"):
            return _reading(foreign_yaml(path), robot)


def _reading(values: Mapping[str, Any], robot: Mapping[str, Any]) -> Reading:
    count = int(values["num_actions"])
    fields: dict[str, Any] = {
        "default_pose": numbers(values["default_angles"]),
        "stiffness": numbers(values["kps"]),
        "damping": numbers(values["kds"]),
        "action_scale": one_or_all(values["action_scale"]),
    }
    missing: dict[str, str] = {}
    _add_steps(values, robot, fields, missing)
    _add_joints(values, count, robot["joints"], fields, missing)
    _add_observations(values, count, fields, missing)
    if values.get("imu_type") == "torso":
        missing["imu"] = "the IMU is in the torso, and the script turns what it measures by the waist's angle"
    if "cmd_init" in values:
        fields["command"] = numbers(values["cmd_init"])
    return Reading(fields, missing)


def _add_steps(
    values: Mapping[str, Any], robot: Mapping[str, Any], fields: dict[str, Any], missing: dict[str, str]
) -> None:
    """Add the steps of the physics and of the control."""
    if "control_decimation" in values:
        fields["time_step"] = float(values["simulation_dt"])
        fields["decimation"] = int(values["control_decimation"])
    elif "control_dt" in values:
        fields["decimation"] = max(1, round(float(values["control_dt"]) / robot["time_step"]))
        fields["time_step"] = float(values["control_dt"]) / fields["decimation"]
    else:
        missing["decimation"] = "the file names neither control_decimation nor control_dt"


def _add_joints(
    values: Mapping[str, Any], count: int, names: list[str], fields: dict[str, Any], missing: dict[str, str]
) -> None:
    """Add the joints that the policy drives, in the order of the model, and those that the script holds."""
    held = values.get("arm_waist_joint2motor_idx")
    motors = values.get("leg_joint2motor_idx", values.get("joint2motor_idx"))
    if motors is None:
        if len(names) == count:
            fields["joints"] = names
        else:
            missing["joints"] = f"the policy drives {count} joints, the model has {len(names)}"
        return
    if values.get("msg_type") == "go":  # the motors of H1 and of the quadrupeds are in another order
        missing["joints"] = "motors of Unitree's older robots have no names in this file"
        return
    fields["joints"] = [names[int(place)] for place in motors][:count]
    if held:
        fields["held"] = [
            {
                "joints": [names[int(place)] for place in held],
                "pose": numbers(values["arm_waist_target"]),
                "stiffness": numbers(values["arm_waist_kps"]),
                "damping": numbers(values["arm_waist_kds"]),
            }
        ]


def _add_observations(values: Mapping[str, Any], count: int, fields: dict[str, Any], missing: dict[str, str]) -> None:
    """Add the observations of the scripts, if they have as many numbers as the file says."""
    terms = [
        observation("base_ang_vel", values["ang_vel_scale"], None, 1),
        observation("projected_gravity", None, None, 1),
        observation("command", values["cmd_scale"], None, 1),
        observation("joint_pos", values["dof_pos_scale"], None, 1),
        observation("joint_vel", values["dof_vel_scale"], None, 1),
        observation("actions", None, None, 1),
    ]
    more = int(values["num_obs"]) - WITHOUT_JOINTS - 3 * count
    if more == 2:
        terms.append({"name": "gait_phase"})
        fields |= {"gait_period": CLOCK, "gait_offsets": [0.0], "gait_while_standing": "run"}
    elif more == 3 and "lin_vel_scale" in values:
        terms.insert(0, observation("base_lin_vel", values["lin_vel_scale"], None, 1))
    elif more:
        missing["observations"] = f"num_obs is {values['num_obs']}, of which the scripts' terms explain {9 + 3 * count}"
        return
    fields["observations"] = terms
