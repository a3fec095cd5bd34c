"""Reader of the `deploy.yaml` that unitree_rl_lab and unitree_rl_mjlab write beside an exported policy.

Sources: both repositories of github.com/unitreerobotics (Apache-2.0), their deploy/include and deploy/robots.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from perdure.errors import PerdureError
from perdure.robots.deployment import as_written_by, foreign_yaml, numbers, observation, one_or_all, top_level_names
from perdure.robots.readers import DeploymentReader, Reading
from perdure.robots.terms import term_name

ARM = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_roll", "wrist_pitch", "wrist_yaw")
LEG = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
G1_MOTORS = (
    *(f"{side}_{part}_joint" for side in ("left", "right") for part in LEG),
    *(f"waist_{part}_joint" for part in ("yaw", "roll", "pitch")),
    *(f"{side}_{part}_joint" for side in ("left", "right") for part in ARM),
)
"""Joints of a G1 in the order of its motors; versions with fewer joints have gaps."""
QUADRUPED_MOTORS = tuple(f"{leg}_{part}_joint" for leg in ("FR", "FL", "RR", "RL") for part in ("hip", "thigh", "calf"))
"""Joints of Go2, B2, Go1 and A1 in the order of their motors; models often begin with the left leg."""
OPTIONS = ("use_gym_history", "scale_first")
"""Entries of `observations` that are no terms."""


class UnitreeDeployment(DeploymentReader):
    """See `words`.

    `joint_ids_map` gives the motor of each joint of the policy. Gains are listed by motor, default pose and action
    scale by joint of the policy. Motors of robots that are not known here are in the order of the model.
    """

    name = "unitree"
    words = "deploy.yaml of unitree_rl_lab and unitree_rl_mjlab"
    suffixes = (".yaml", ".yml")

    def recognizes(self, path: Path) -> bool:
        """See `ContractReader.recognizes`."""
        return {"joint_ids_map", "step_dt", "observations", "actions"} <= top_level_names(path)

    def reading(self, path: Path, robot: Mapping[str, Any]) -> Reading:
        """See `DeploymentReader.reading`."""
        with as_written_by("Unitree's code"):
            return _reading(foreign_yaml(path), robot)


def _reading(values: Mapping[str, Any], robot: Mapping[str, Any]) -> Reading:
    motors = _motors(robot["joints"])
    places = [int(each) for each in values["joint_ids_map"]]
    decimation = max(1, round(float(values["step_dt"]) / robot["time_step"]))
    pose = numbers(values["default_joint_pos"])
    fields: dict[str, Any] = {
        "joints": [motors[place] for place in places],
        "default_pose": pose,
        "stiffness": [float(values["stiffness"][place]) for place in places],
        "damping": [float(values["damping"][place]) for place in places],
        "time_step": float(values["step_dt"]) / decimation,
        "decimation": decimation,
    }
    missing: dict[str, str] = {}
    _add_action(values["actions"], pose, fields, missing)
    _add_observations(values["observations"], fields, missing)
    _add_command(values.get("commands"), fields)
    return Reading(fields, missing)


def _motors(joints: Sequence[str]) -> Sequence[str]:
    """Return the names of the joints of a robot in the order of its motors."""
    for known in (G1_MOTORS, QUADRUPED_MOTORS):
        if set(known) & set(joints):
            return known
    return joints


def _add_action(actions: Mapping[str, Any], pose: list[float], fields: dict[str, Any], missing: dict[str, str]) -> None:
    """Add the scale of the actions, and what a contract cannot hold of them."""
    (name, action), *others = actions.items()
    if others or name != "JointPositionAction":
        missing["action_scale"] = f"actions are {', '.join(actions)}; a contract has one JointPositionAction"
        return
    fields["action_scale"] = one_or_all(action["scale"])
    offset = action.get("offset")
    if offset is not None and numbers(offset) != pose:
        missing["default_pose"] = "the offset of the actions is another pose than the one that observations start from"
    if action.get("clip") is not None:
        missing["action_clip"] = "joint targets are clipped; a contract clips actions, before their scale"
    chosen = action.get("joint_ids")
    if isinstance(chosen, list) and chosen not in ([None, None, None], list(range(len(pose)))):
        missing["joints"] = f"actions drive {len(chosen)} of the {len(pose)} joints that are observed"


def _add_observations(given: Mapping[str, Any], fields: dict[str, Any], missing: dict[str, str]) -> None:
    """Add the observation terms, the layout of their history and the gait clock."""
    groups = [each for each in given.values() if _is_group(each)]
    if len(groups) == 1:
        given = groups[0]
    elif groups:
        missing["observations"] = f"there are several groups of observations: {', '.join(given)}"
        return
    if given.get("use_gym_history"):
        fields["history_layout"] = "by step"
    terms = {str(name): each for name, each in given.items() if name not in OPTIONS}
    unknown = [name for name in terms if term_name(name) is None]
    if unknown:
        missing["observations"] = f"there is no term {', '.join(unknown)} (perdure list observations)"
    found = []
    for name, each in terms.items():
        parameters = each.get("params") or {}
        if isinstance(parameters.get("asset_cfg"), Mapping) and parameters["asset_cfg"].get("joint_ids"):
            missing["observations"] = f"{name} observes some of the joints only"
        if name == "gait_phase":
            fields["gait_period"] = float(parameters["period"])
            fields["gait_offsets"] = [0.0]
            fields["gait_while_standing"] = "run"
        try:
            first = bool(given.get("scale_first", False))
            term = observation(name, each.get("scale"), each.get("clip"), int(each.get("history_length") or 1), first)
        except PerdureError as error:
            missing["observations"] = str(error)
            continue
        found.append(term)
    fields["observations"] = found


def _is_group(entry: Any) -> bool:
    """Return whether an entry of `observations` holds terms and is none itself."""
    if not isinstance(entry, Mapping):
        return False
    return any(isinstance(each, Mapping) and "history_length" in each for each in entry.values())


def _add_command(commands: Any, fields: dict[str, Any]) -> None:
    """Add a walk forward, as fast as the commands of the file allow; left out: that of every contract."""
    if not isinstance(commands, Mapping) or "base_velocity" not in commands:
        return
    ranges = commands["base_velocity"]["ranges"]
    fastest = float(ranges["lin_vel_x"][1])
    if fastest < 0.5:
        fields["command"] = [max(0.0, fastest), 0.0, 0.0]
