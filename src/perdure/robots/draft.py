"""`perdure robot init`: a commented draft of a contract, from a robot's MJCF and, if there is one, its exported policy.

Values come from the first of these that has them: the metadata of the ONNX file (mjlab, holosoma), the `deploy.yaml`
that Unitree's repositories write beside it, the model. What none of them has is marked with FILL IN and commented out,
so that `perdure robot check` names it as missing.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from perdure.errors import PerdureError
from perdure.policy.onnx import metadata
from perdure.robots.contract import Contract, field_texts
from perdure.robots.readers import from_metadata, parse_yaml
from perdure.robots.terms import ObservationTerm, term_name
from perdure.runs import read_bounded

MARK = "FILL IN"
"""Marks what the author of the policy must add."""
CONTROL_SECONDS = 0.02
"""Control step of most walking policies, assumed where no file names one."""
YAML_VALUES = ("true", "false", "yes", "no", "on", "off", "null")
"""Words that YAML does not read as text."""
WIDTH = 100
"""Columns of a line of numbers."""
EXAMPLES = {
    "stiffness": "20.0",
    "damping": "0.5",
    "action_scale": "0.25",
    "observations": "[base_ang_vel, projected_gravity, command, joint_pos, joint_vel, actions]",
}
"""What a field that nothing says may look like."""


def draft(model: Path, policy: Path | None, folder: Path) -> str:
    """Return the text of a contract.

    Args:
        model: The robot's MJCF.
        policy: Its exported policy, if there is one.
        folder: Where the contract will lie; paths in it are relative to this folder.

    Raises:
        PerdureError: If a file cannot be read, or the model has no joint to drive.
    """
    facts = _of_model(model)
    sources = [("of the model", facts)]
    if policy is not None:
        deployed = _deploy_file(policy)
        if deployed is not None:
            sources.insert(0, (f"of {deployed.name}", _of_deployment(deployed, facts)))
        sources.insert(0, (f"of the metadata of {policy.name}", from_metadata(metadata(policy))))
    lines = [
        f"# Contract of {model.name}, drafted by perdure robot init. Compare every value with training.",
        f"# Lines marked {MARK} must be completed. Then: perdure robot check THIS_FILE --policy policy.onnx",
        f"model: {_path(model, folder)}",
    ]
    joints: Sequence[str] = facts["joints"]
    for name in ("joints", "default_pose", "stiffness", "damping", "action_scale", "time_step", "decimation"):
        value, source = _first(name, sources)
        if name == "joints":
            joints = value
        elif isinstance(value, dict):
            value = _in_order(value, joints)
        lines += _field(name, value, source)
    value, source = _first("observations", sources)
    lines += _field("observations", value, source)
    if value is None:
        lines += [f"#   {name}: {kind.words}" for name, kind in ObservationTerm.kinds().items()]
    return "\n".join([*lines, *_limits(facts, joints), ""])


def _first(name: str, sources: Sequence[tuple[str, Mapping[str, Any]]]) -> tuple[Any, str]:
    """Return the value of a field from the first source that has it, and which one; (None, "") if none has."""
    for source, values in sources:
        if values.get(name) is not None:
            return values[name], source
    return None, ""


def _in_order(values: Mapping[str, float], joints: Sequence[str]) -> list[float] | None:
    """Return one value for each joint; None if one has none."""
    if not all(joint in values for joint in joints):
        return None
    return [values[joint] for joint in joints]


def _field(name: str, value: Any, source: str) -> list[str]:
    """Return the lines of a field: what it means, where its value comes from, the value."""
    text = field_texts(Contract)[name]
    if value is None:
        return [f"# {MARK} {text}", f"# {name}: {EXAMPLES.get(name, '')}"]
    comment = f"# {text} Here: {source}."
    if name == "observations":
        return [comment, f"{name}:", *(f"  - {_flow(each)}" for each in value)]
    if isinstance(value, list | tuple):
        return [comment, *_wrapped(f"{name}: [", [_flow(each) for each in value])]
    return [comment, f"{name}: {_flow(value)}"]


def _flow(value: Any) -> str:
    """Return a value as YAML on one line."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{name}: {_flow(each)}" for name, each in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_flow, value)) + "]"
    if isinstance(value, float) and math.isinf(value):
        return {math.inf: ".inf", -math.inf: "-.inf"}[value]
    if isinstance(value, float):
        rounded = float(f"{value:.6g}")
        return repr(rounded)
    if isinstance(value, int):
        return str(value)
    return _quoted(str(value))


def _quoted(text: str) -> str:
    """Return a name as YAML; quoted where it could be read as something else."""
    if re.fullmatch(r"[A-Za-z_][\w./-]*", text) and text.lower() not in YAML_VALUES:
        return text
    return "'" + text.replace("'", "''") + "'"


def _wrapped(begin: str, words: Sequence[str]) -> list[str]:
    """Return a list of YAML in lines of at most WIDTH columns."""
    lines = [begin]
    for place, word in enumerate(words):
        piece = f"{word},"
        if place == len(words) - 1:
            piece = f"{word}]"
        if len(lines[-1]) + len(piece) + 1 > WIDTH:
            lines.append("  ")
        if not lines[-1].endswith(("[", "  ")):
            lines[-1] += " "
        lines[-1] += piece
    return lines


def _path(model: Path, folder: Path) -> str:
    return _quoted(os.path.relpath(model.resolve(), folder.resolve()))


def _limits(facts: Mapping[str, Any], joints: Sequence[str]) -> list[str]:
    """Return the lines of what the model holds and the contract may replace, and of the command."""
    texts = field_texts(Contract)
    lines = []
    for name in ("effort_limit", "armature"):
        values = facts[name]
        lines.append(f"# {texts[name]}")
        bare = [joint for joint in joints if not values.get(joint)]
        if bare:
            lines.append(
                f"# {MARK} {name}: the model has none for {len(bare)} of {len(joints)} joints, such as {bare[0]}"
            )
        shown = [float(values.get(joint, 0.0)) for joint in joints]
        lines += [f"# {line}" for line in _wrapped(f"{name}: [", [_flow(each) for each in shown])]
    if facts["integrator"] != "IMPLICITFAST":
        lines.append(f"# The model's integrator is {facts['integrator']}. mjlab and Isaac Lab damp joints implicitly:")
        lines.append('# <option integrator="implicitfast"/> in the model.')
    lines += [f"# {texts['command']}", "command: [0.5, 0.0, 0.0]"]
    return lines


# Where values come from


def _of_model(path: Path) -> dict[str, Any]:
    """Return what a model says of each joint, by its name, and of its steps."""
    import mujoco

    if not path.is_file():
        raise PerdureError(f"there is no model {path}")
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise PerdureError(f"{path}: {' '.join(str(error).split())[:300]}") from None
    kinds = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    joints = [model.joint(k) for k in range(model.njnt) if int(model.jnt_type[k]) in kinds]
    if not joints:
        raise PerdureError(f"{path} has no joint that can be driven")
    pose = model.qpos0
    if model.nkey:
        pose = model.key_qpos[0]
    found: dict[str, Any] = {
        "joints": [joint.name for joint in joints],
        "default_pose": {joint.name: float(pose[joint.qposadr[0]]) for joint in joints},
        "time_step": float(model.opt.timestep),
        "decimation": max(1, round(CONTROL_SECONDS / model.opt.timestep)),
        "armature": {joint.name: float(model.dof_armature[joint.dofadr[0]]) for joint in joints},
        "integrator": mujoco.mjtIntegrator(int(model.opt.integrator)).name.removeprefix("mjINT_"),
    }
    return found | _of_actuators(model, mujoco)


def _of_actuators(model: Any, mujoco: Any) -> dict[str, Any]:
    """Return gains and torque limits by joint, of position actuators (affine bias) and of the joints' own limits."""
    stiffness = {}
    damping = {}
    limits = {}
    for k in range(model.njnt):
        if model.jnt_actfrclimited[k]:
            limits[model.joint(k).name] = float(model.jnt_actfrcrange[k, 1])
    for k in range(model.nu):
        if model.actuator_trntype[k] != int(mujoco.mjtTrn.mjTRN_JOINT):
            continue
        joint = model.joint(model.actuator_trnid[k, 0]).name
        gear = abs(float(model.actuator_gear[k, 0]))
        if model.actuator_biastype[k] == int(mujoco.mjtBias.mjBIAS_AFFINE):
            # A gear scales the actuator's length, and again the torque that its force makes.
            stiffness[joint] = float(model.actuator_gainprm[k, 0]) * gear**2
            damping[joint] = -float(model.actuator_biasprm[k, 2]) * gear**2
        if model.actuator_forcelimited[k]:
            limits[joint] = float(model.actuator_forcerange[k, 1]) * gear
        elif model.actuator_biastype[k] == int(mujoco.mjtBias.mjBIAS_NONE) and model.actuator_ctrllimited[k]:
            limits[joint] = float(model.actuator_ctrlrange[k, 1] * model.actuator_gainprm[k, 0]) * gear
    return {"stiffness": stiffness or None, "damping": damping or None, "effort_limit": limits}


def _deploy_file(policy: Path) -> Path | None:
    """Return the `deploy.yaml` of a policy, as unitree_rl_lab and unitree_rl_mjlab lay it; None without one."""
    for folder in (policy.parent, policy.parent.parent / "params", policy.parent / "params"):
        if (folder / "deploy.yaml").is_file():
            return folder / "deploy.yaml"
    return None


def _of_deployment(path: Path, facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields that a `deploy.yaml` of Unitree's repositories holds.

    `joint_ids_map` gives the motor of each joint of the policy. Motors are in the order of the model; gains are listed
    by motor, default pose and action scale by joint of the policy.
    """
    values = parse_yaml(read_bounded(path, 1_000_000), foreign=True)
    try:
        places = [int(each) for each in values["joint_ids_map"]]
        found: dict[str, Any] = {
            "joints": [facts["joints"][place] for place in places],
            "default_pose": [float(each) for each in values["default_joint_pos"]],
            "stiffness": [float(values["stiffness"][place]) for place in places],
            "damping": [float(values["damping"][place]) for place in places],
            "decimation": max(1, round(float(values["step_dt"]) / facts["time_step"])),
            "observations": [_term(name, each) for name, each in values["observations"].items()],
        }
        (action,) = values["actions"].values()
        scale = action["scale"]
        if isinstance(scale, list):
            found["action_scale"] = [float(each) for each in scale]
        else:
            found["action_scale"] = float(scale)
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise PerdureError(f"{path} is not as Unitree's repositories write it: {error}") from None
    return found


def _term(name: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return an observation term of a `deploy.yaml`."""
    term: dict[str, Any] = {"name": term_name(str(name)) or str(name)}
    scale = values.get("scale")
    if isinstance(scale, list) and len(set(map(float, scale))) == 1:
        scale = float(scale[0])
    if scale not in (None, 1.0):
        term["scale"] = scale
    if values.get("clip") is not None:
        term["clip"] = [float(each) for each in values["clip"]]
    if values.get("history_length", 1) != 1:
        term["history"] = int(values["history_length"])
    return term
