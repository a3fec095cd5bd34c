"""Models and poses that the tests of the Fetch share."""

import mujoco
import numpy as np

from perdure.home.sim.robot import ROBOT

STEPS_PER_COMMAND = {1 / 120: 4, 1 / 240: 8}


def make_spec(timestep=1 / 120):
    spec = mujoco.MjSpec()
    spec.option.timestep = timestep
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return spec


def set_pose(data, arm=ROBOT.rest_arm, torso=ROBOT.torso_height, base=(0.0, 0.0, 0.0)):
    """Puts the robot there, its servos' targets too."""
    for joint, value in zip(("base_x", "base_y", "base_yaw"), base, strict=True):
        data.joint(joint).qpos = value
    for joint, value in ((ROBOT.torso.name, torso), *zip(ROBOT.arm_names, arm, strict=True)):
        data.joint(joint).qpos = value
        data.actuator(joint).ctrl = value
    mujoco.mj_forward(data.model, data)


def arm_angles(data):
    return np.array([data.joint(joint).qpos[0] for joint in ROBOT.arm_names])


def touching(data):
    """Names of the pairs of geoms in contact, each pair sorted."""
    name = data.model.geom
    return {tuple(sorted((name(c.geom1).name, name(c.geom2).name))) for c in data.contact}
