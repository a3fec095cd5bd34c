"""`perdure robot init`: a commented draft of a contract, from a robot's MJCF and what comes with its policy.

Values come from the first of these that has them: a deployment file that the user names, the metadata of the ONNX file
(mjlab, holosoma), the `deploy.yaml` and `env.yaml` that Unitree's repositories and Isaac Lab write beside it, the
model. What none of them has is marked with FILL IN and commented out, so that `perdure robot check` names it.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from perdure.errors import PerdureError
from perdure.robots.contract import Contract, field_texts
from perdure.robots.mjcf import read_model
from perdure.robots.readers import DeploymentReader, Reading, find_reader
from perdure.robots.terms import ObservationTerm

MARK = "FILL IN"
"""Marks what the author of the policy must add."""
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
ALWAYS = (
    "joints",
    "default_pose",
    "stiffness",
    "damping",
    "action_scale",
    "time_step",
    "decimation",
    "observations",
)
"""Fields of every draft."""
SOMETIMES = (
    "history_layout",
    "gait_period",
    "gait_offsets",
    "gait_while_standing",
    "imu",
    "action_clip",
    "action_delay",
    "held",
    "velocity_limit",
    "saturation_effort",
)
"""Fields of a draft where a deployment file says them, or cannot say them."""
BESIDE = ("deploy.yaml", "env.yaml")
"""Names of the files that exporters write beside a policy."""


def draft(model: Path, policy: Path | None, folder: Path, deployment: Path | None = None) -> str:
    """Return the text of a contract.

    Args:
        model: The robot's MJCF.
        policy: Its exported policy, if there is one.
        folder: Where the contract will lie; paths in it are relative to this folder.
        deployment: A file that says how the policy is deployed, which a `DeploymentReader` recognizes.

    Raises:
        PerdureError: If a file cannot be read, or the model has no joint to drive.
    """
    robot = read_model(model)
    sources = [(f"of {path.name}", _reading(path, robot)) for path in _files(policy, deployment)]
    sources.append(("of the model", Reading(dict(robot))))
    lines = [
        f"# Contract of {model.name}, drafted by perdure robot init. Compare every value with training.",
        f"# Lines marked {MARK} must be completed. Then: perdure robot check THIS_FILE --policy policy.onnx",
        f"model: {_path(model, folder)}",
    ]
    joints = _first("joints", sources)[0] or robot["joints"]
    for name in (*ALWAYS, *SOMETIMES):
        value, source, reason = _first(name, sources)
        if isinstance(value, dict):
            value = _in_order(value, joints)
        if name in ALWAYS or value is not None or reason:
            lines += _field(name, value, source, reason)
        if name == "observations" and value is None:
            lines += [f"#   {name}: {kind.words}" for name, kind in ObservationTerm.kinds().items()]
    for name in ("effort_limit", "armature"):
        value, source, _ = _first(name, sources[:-1])
        if value is None:
            lines += _of_the_model(name, robot[name], joints)
        else:
            lines += _field(name, value, source)
    return "\n".join([*lines, *_rest(robot, _first("command", sources)[0]), ""])


def _files(policy: Path | None, deployment: Path | None) -> list[Path]:
    """Return the files that say something of a policy, those that come first before others."""
    found = []
    if deployment is not None:
        found.append(deployment)
    if policy is not None:
        found.append(policy)
        for name in BESIDE:
            folders = (policy.parent, policy.parent.parent / "params", policy.parent / "params")
            found += [folder / name for folder in folders if (folder / name).is_file()][:1]
    return list(dict.fromkeys(found))


def _reading(path: Path, robot: Mapping[str, Any]) -> Reading:
    """Return what a file says; PerdureError, with its name, if it cannot be read."""
    reader = find_reader(path)
    if not isinstance(reader, DeploymentReader):
        raise PerdureError(f"{path} is no deployment file that perdure reads")
    try:
        return reader.reading(path, robot)
    except PerdureError as error:
        raise PerdureError(f"{path}: {error}") from None


def _first(name: str, sources: Sequence[tuple[str, Reading]]) -> tuple[Any, str, str]:
    """Return the value of a field from the first source that has it, which one, and what it cannot say of it."""
    for source, reading in sources:
        reason = reading.missing.get(name, "")
        value = reading.fields.get(name)
        if value is not None or reason:
            return value, source, reason
    return None, "", ""


def _in_order(values: Mapping[str, float], joints: Sequence[str]) -> list[float] | None:
    """Return one value for each joint; None if one has none."""
    if not all(joint in values for joint in joints):
        return None
    return [values[joint] for joint in joints]


def _field(name: str, value: Any, source: str, reason: str = "") -> list[str]:
    """Return the lines of a field: what it means, where its value comes from, the value; commented out for a reason."""
    text = field_texts(Contract)[name]
    if value is None:
        if reason:
            text += f" Of {source.removeprefix('of ')}: {reason}."
        return [f"# {MARK} {text}", f"# {name}: {EXAMPLES.get(name, '')}"]
    if name == "observations":
        lines = [f"{name}:", *(f"  - {_flow(each)}" for each in value)]
    elif isinstance(value, list | tuple):
        lines = _wrapped(f"{name}: [", [_flow(each) for each in value])
    else:
        lines = [f"{name}: {_flow(value)}"]
    if reason:
        return [f"# {MARK} {text} Here: {source}, but {reason}.", *(f"# {line}" for line in lines)]
    return [f"# {text} Here: {source}.", *lines]


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


def _of_the_model(name: str, values: Mapping[str, float], joints: Sequence[str]) -> list[str]:
    """Return the lines of what the model holds of each joint and the contract may replace, commented out."""
    lines = [f"# {field_texts(Contract)[name]}"]
    bare = [joint for joint in joints if not values.get(joint)]
    if bare:
        lines.append(f"# {MARK} {name}: the model has none for {len(bare)} of {len(joints)} joints, such as {bare[0]}")
    shown = [float(values.get(joint, 0.0)) for joint in joints]
    return [*lines, *(f"# {line}" for line in _wrapped(f"{name}: [", [_flow(each) for each in shown]))]


def _rest(robot: Mapping[str, Any], command: Any) -> list[str]:
    """Return the lines of the integrator and of the command."""
    lines = []
    if robot["integrator"] != "IMPLICITFAST":
        lines.append(f"# The model's integrator is {robot['integrator']}. mjlab and Isaac Lab damp joints implicitly:")
        lines.append('# <option integrator="implicitfast"/> in the model.')
    return [*lines, f"# {field_texts(Contract)['command']}", f"command: {_flow(command or [0.5, 0.0, 0.0])}"]
