"""The motors: velocity servos for the base, stiff position servos for everything else.

A position servo pulls with kp (target - q) - kv q', clipped at the motor's effort. Its gains come from the inertia I
it was made for: kp = I w^2 and kv = 2 z I w, with w = 60 rad/s and z = 0.7 (OURS: the benchmark's own motors follow
almost at once, and so must these). A target that moves at speed v is then followed 2 z v / w behind: 0.018 rad at the
largest command, 0.025 rad per 1/30 s. Every joint gets rotor inertia (armature), as geared motors have, without which
links of 0.002 kg m^2 could not be held stiffly at steps of 1/120 s.
"""

from __future__ import annotations

from typing import Any

from perdure.home.sim.robot.links import ARM, FINGERS, TORSO

STIFFNESS_RATE = 60.0
"""Natural frequency w of the position servos in [rad/s]."""
DAMPING_RATIO = 0.7

INERTIA = {
    "torso_lift_joint": 30.0,
    "shoulder_pan_joint": 3.0,
    "shoulder_lift_joint": 3.0,
    "upperarm_roll_joint": 1.0,
    "elbow_flex_joint": 1.0,
    "forearm_roll_joint": 0.3,
    "wrist_flex_joint": 0.3,
    "wrist_roll_joint": 0.1,
    "l_gripper_finger_joint": 0.5,
    "r_gripper_finger_joint": 0.5,
}
"""OURS: the inertia I each servo is made for in [kg m^2] or [kg]: the arm stretched out, rotor included."""
ARMATURE = {
    "shoulder_pan_joint": 0.3,
    "shoulder_lift_joint": 0.3,
    "upperarm_roll_joint": 0.2,
    "elbow_flex_joint": 0.2,
    "forearm_roll_joint": 0.1,
    "wrist_flex_joint": 0.1,
    "wrist_roll_joint": 0.05,
    "l_gripper_finger_joint": 0.4,
    "r_gripper_finger_joint": 0.4,
}
"""OURS: rotor inertia in [kg m^2] or [kg]."""

BASE_GAIN = {"base_x": 10_000.0, "base_y": 10_000.0, "base_yaw": 500.0}
"""OURS: force per velocity error in [N s/m], [N m s/rad]: the base follows within 12 to 20 ms."""
BASE_FORCE = {"base_x": 800.0, "base_y": 800.0, "base_yaw": 150.0}
"""OURS: what the wheels can pass to the floor, 0.67 of the robot's weight of 121 kg; as a torque at their 0.187 m."""
EFFORT = {"shoulder_pan_joint": 200.0}
"""OURS: the URDF's 33.82 N m cannot hold the arm when the base starts or stops within 0.2 s, as the benchmark's base
does; its own motors push with up to 10 N m s in 1/120 s. All other joints keep the URDF's effort."""


def add_servos(spec: Any) -> None:
    """Add the thirteen actuators, each named after its joint, in the order of the joints."""
    for joint, gain in BASE_GAIN.items():
        _add(spec, joint, gain, (0.0, 0.0, -gain), BASE_FORCE[joint])
    for link in (TORSO, *ARM, *FINGERS):
        kp = INERTIA[link.joint] * STIFFNESS_RATE**2
        kv = 2.0 * DAMPING_RATIO * INERTIA[link.joint] * STIFFNESS_RATE
        effort = EFFORT.get(link.joint, link.effort)
        _add(spec, link.joint, kp, (0.0, -kp, -kv), effort, link.limit)


def _add(
    spec: Any,
    joint: str,
    gain: float,
    bias: tuple[float, float, float],
    force: float,
    limit: tuple[float, float] | None = None,
) -> None:
    import mujoco

    actuator = spec.add_actuator(
        name=joint,
        target=joint,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        gaintype=mujoco.mjtGain.mjGAIN_FIXED,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        forcelimited=mujoco.mjtLimited.mjLIMITED_TRUE,
        forcerange=(-force, force),
        ctrllimited=mujoco.mjtLimited.mjLIMITED_FALSE if limit is None else mujoco.mjtLimited.mjLIMITED_TRUE,
        ctrlrange=(0.0, 0.0) if limit is None else limit,
    )
    actuator.gainprm[0] = gain
    actuator.biasprm[:3] = bias
