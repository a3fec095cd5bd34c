"""Reader of the `env.yaml` that Isaac Lab writes into the folder `params` of a training run.

It holds the configuration of a manager-based environment. Joints are named by regular expressions there; their order is
that of PhysX, breadth first in the tree of bodies. Source: Isaac Lab 2.x (BSD-3-Clause), its observation and action
managers and actuator models.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from perdure.robots.deployment import as_written_by, foreign_yaml, matched, observation, top_level_names
from perdure.robots.readers import DeploymentReader, Reading
from perdure.robots.terms import term_name

TERMS = {"generated_commands": "command", "joint_pos": "joint_pos_abs", "joint_vel": "joint_vel", "phase": "gait_phase"}
"""Functions of Isaac Lab whose names mean another term here, or none."""
GAINS = ("stiffness", "damping")


class IsaacLabEnvironment(DeploymentReader):
    """See `words`."""

    name = "isaac_lab"
    words = "env.yaml of a manager-based environment of Isaac Lab"
    suffixes = (".yaml", ".yml")

    def recognizes(self, path: Path) -> bool:
        """See `ContractReader.recognizes`."""
        return {"scene", "sim", "decimation", "observations", "actions"} <= top_level_names(path)

    def reading(self, path: Path, robot: Mapping[str, Any]) -> Reading:
        """See `DeploymentReader.reading`."""
        with as_written_by("Isaac Lab"):
            return _reading(foreign_yaml(path), robot)


def _reading(values: Mapping[str, Any], robot: Mapping[str, Any]) -> Reading:
    fields: dict[str, Any] = {"time_step": float(values["sim"]["dt"]), "decimation": int(values["decimation"])}
    missing: dict[str, str] = {}
    (asset,) = [each for each in values["scene"].values() if isinstance(each, Mapping) and "actuators" in each]
    _add_action(values["actions"], robot["breadth first"], fields, missing)
    joints = fields.get("joints", [])
    if joints:
        fields["default_pose"] = matched(asset["init_state"]["joint_pos"], joints, 0.0)
        _add_motors(_motors(asset["actuators"], robot["breadth first"], missing), asset, fields, missing)
    _add_observations(values["observations"].get("policy"), fields, missing)
    return Reading(fields, missing)


def _add_action(
    actions: Mapping[str, Any], names: Sequence[str], fields: dict[str, Any], missing: dict[str, str]
) -> None:
    """Add the driven joints and the scale of the actions."""
    kinds = [str(each.get("class_type", "")).rpartition(":")[2] for each in actions.values()]
    if kinds != ["JointPositionAction"]:
        missing["action_scale"] = f"actions are {', '.join(kinds)}; a contract has one JointPositionAction"
        return
    (action,) = actions.values()
    patterns = _listed(action["joint_names"])
    joints = [name for name in names if _any(patterns, name)]
    if action.get("preserve_order"):
        joints = [name for pattern in patterns for name in names if re.fullmatch(pattern, name)]
    if not joints:
        missing["joints"] = f"no joint of the model matches {', '.join(patterns)}"
        return
    fields["joints"] = joints
    fields["action_scale"] = matched(action.get("scale", 1.0), joints, 1.0)
    if not action.get("use_default_offset", True):
        missing["default_pose"] = "joint targets do not start from the default pose (use_default_offset: false)"
    if action.get("clip") is not None:
        missing["action_clip"] = "joint targets are clipped; a contract clips actions, before their scale"


def _motors(groups: Mapping[str, Any], names: Sequence[str], missing: dict[str, str]) -> dict[str, dict[str, float]]:
    """Return gains, limits and inertia of every joint of the model that a group of actuators drives."""
    motors: dict[str, dict[str, float]] = {}
    for group, actuator in groups.items():
        kind = str(actuator.get("class_type", "")).rpartition(":")[2]
        if "Net" in kind:
            missing["stiffness"] = f"the actuators {group} are a network ({kind}), not a controller with gains"
        if actuator.get("max_delay") or actuator.get("min_delay"):
            late = f"{actuator.get('min_delay', 0)} to {actuator['max_delay']}"
            missing["action_delay"] = f"the actuators {group} act {late} physics steps late; write control steps"
        limits = ("effort_limit_sim", "effort_limit")
        if kind != "ImplicitActuator":
            limits = ("effort_limit", "effort_limit_sim")
        wanted = {name: (name,) for name in (*GAINS, "armature")} | {"effort_limit": limits}
        if kind == "DCMotor":
            wanted |= {"velocity_limit": ("velocity_limit",), "saturation_effort": ("saturation_effort",)}
        mine = [name for name in names if _any(_listed(actuator["joint_names_expr"]), name)]
        for joint in mine:
            motors[joint] = {}
            for field, choices in wanted.items():
                value = next((actuator[name] for name in choices if actuator.get(name) is not None), None)
                number = None if value is None else matched(value, [joint])
                if number is not None:
                    motors[joint][field] = number[0]
    return motors


def _add_motors(
    motors: Mapping[str, Mapping[str, float]], asset: Mapping[str, Any], fields: dict[str, Any], missing: dict[str, str]
) -> None:
    """Add what the motors of the driven joints are, and the joints that their motors hold at the default pose."""
    joints = fields["joints"]
    for name in (*GAINS, "effort_limit", "armature", "velocity_limit", "saturation_effort"):
        bare = [joint for joint in joints if name not in motors.get(joint, {})]
        if not bare:
            fields[name] = [motors[joint][name] for joint in joints]
        elif name in GAINS:
            missing.setdefault(name, f"no actuators say it for {', '.join(bare[:5])}")
        elif len(bare) < len(joints):
            missing[name] = f"some actuators say it, but not those of {', '.join(bare[:5])}"
    held = [joint for joint in motors if joint not in joints]
    if held and all(name in motors[joint] for joint in held for name in GAINS):
        pose = matched(asset["init_state"]["joint_pos"], held, 0.0)
        gains = {name: [motors[joint][name] for joint in held] for name in GAINS}
        fields["held"] = [{"joints": held, "pose": pose, **gains}]


def _add_observations(group: Any, fields: dict[str, Any], missing: dict[str, str]) -> None:
    """Add the terms of the policy's group; those of the critic do not matter."""
    if not isinstance(group, Mapping):
        missing["observations"] = "there is no group of observations named policy"
        return
    if not group.get("concatenate_terms", True):
        missing["observations"] = "terms are not joined to one vector (concatenate_terms: false)"
    found = []
    for name, each in group.items():
        if not isinstance(each, Mapping) or "func" not in each:
            continue
        function = str(each["func"]).rpartition(":")[2]
        term = TERMS.get(function) or term_name(function)
        problem = _unreadable(each, name, term)
        if problem:
            missing.setdefault("observations", problem)
            continue
        assert term is not None
        if term == "gait_phase":
            fields |= {"gait_period": float(each["params"]["period"]), "gait_offsets": [0.0]}
            fields["gait_while_standing"] = "run"
        history = each.get("history_length") or 0
        if group.get("history_length") is not None:  # it overrides those of the terms
            history = group["history_length"]
        found.append(observation(term, each.get("scale"), each.get("clip"), int(history)))
    fields["observations"] = found


def _unreadable(term: Mapping[str, Any], name: str, known: str | None) -> str:
    """Return what a contract cannot hold of a term; empty if nothing."""
    if known is None:
        return f"there is no term for {name} ({term['func']}; perdure list observations)"
    if term.get("modifiers"):
        return f"{name} has modifiers, such as filters"
    chosen = ((term.get("params") or {}).get("asset_cfg") or {}).get("joint_names")
    if chosen is not None and _listed(chosen) != [".*"]:
        return f"{name} observes some of the joints only"
    return ""


def _listed(values: Any) -> list[str]:
    if isinstance(values, str):
        return [values]
    return [str(each) for each in values]


def _any(patterns: Sequence[str], name: str) -> bool:
    return any(re.fullmatch(pattern, name) for pattern in patterns)
