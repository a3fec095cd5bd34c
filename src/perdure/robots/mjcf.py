"""What the MJCF of a robot says of its joints: names and order, home pose, gains, torque limits, rotor inertia."""

from __future__ import annotations

from collections import deque
from functools import lru_cache
from pathlib import Path
from typing import Any

from perdure.errors import PerdureError

CONTROL_SECONDS = 0.02
"""Control step of most walking policies, assumed where no file names one."""


def read_model(path: Path) -> dict[str, Any]:
    """Return what a model says of each joint, by its name, and of its steps. It must not be changed.

    Raises:
        PerdureError: If the model cannot be read, or has no joint to drive.
    """
    if not path.is_file():
        raise PerdureError(f"there is no model {path}")
    state = path.stat()
    return _read_model(path, state.st_size, state.st_mtime_ns)


@lru_cache(8)
def _read_model(path: Path, size: int, changed: int) -> dict[str, Any]:
    """Return the same; size and time are only part of the key of the cache."""
    import mujoco

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
        "breadth first": _breadth_first(model, [joint.id for joint in joints]),
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


def _breadth_first(model: Any, joints: list[int]) -> list[str]:
    """Return the names of joints by their depth in the tree of bodies: the order of PhysX, so of Isaac Lab."""
    found: list[str] = []
    waiting = deque([0])
    while waiting:
        body = waiting.popleft()
        found += [model.joint(k).name for k in joints if model.jnt_bodyid[k] == body]
        waiting.extend(child for child in range(1, model.nbody) if model.body_parentid[child] == body)
    return found
