"""A wide table with the layouts' friction and objects on or above it, for tests of the objects."""

import math

import numpy as np

from perdure.home.sim.apartments import FRICTION
from perdure.home.sim.objects import KINDS, Placement, add_object

ELLIPTIC = 1


def scene(placed, timestep=1 / 240, sleep=True, cone=0, visuals=False, edit=lambda spec: None):
    """A model with objects `name: (kind, position, quaternion)` and a table whose top is at height 0."""
    import mujoco

    spec = mujoco.MjSpec()
    spec.option.timestep = timestep
    spec.option.cone = cone
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    if sleep:
        spec.option.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
    box = mujoco.mjtGeom.mjGEOM_BOX
    spec.worldbody.add_geom(name="table", type=box, size=(3, 3, 0.02), pos=(0, 0, -0.02), friction=FRICTION)
    for name, (kind, position, quaternion) in placed.items():
        add_object(spec, Placement(kind, position, quaternion, ""), name, visuals=visuals)
    edit(spec)
    model = spec.compile()
    return model, mujoco.MjData(model)


def run(model, data, seconds):
    import mujoco

    mujoco.mj_step(model, data, nstep=round(seconds / model.opt.timestep))


def turned(angle, axis):
    """Quaternion of a turn about a unit vector."""
    return (math.cos(angle / 2), *(math.sin(angle / 2) * np.array(axis, dtype=float)))


def rotation(quaternion):
    import mujoco

    flat = np.empty(9)
    mujoco.mju_quat2Mat(flat, np.array(quaternion, dtype=float))
    return flat.reshape(3, 3)


def box_clearance(kind, quaternion):
    """How far the frame is above the lowest corner of the turned bounding box."""
    half = np.array(KINDS[kind].half)
    return float(np.abs(rotation(quaternion)[2]) @ half)


def uprightness(data, name):
    """Cosine of the angle between an object's z axis and the vertical."""
    return float(data.body(name).xmat[8])


def colliding_corners(model, name):
    """Lower and upper corner of everything of a body that collides, in the body's frame: vertices, axes, radii."""
    import mujoco

    body, points = model.body(name), []
    for k in range(body.geomadr[0], body.geomadr[0] + body.geomnum[0]):
        geom = model.geom(k)
        if not geom.contype[0]:
            continue
        turn, size = rotation(geom.quat), geom.size
        if geom.type[0] == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.mesh(geom.dataid[0])
            first = mesh.vertadr[0]
            points.append(model.mesh_vert[first : first + mesh.vertnum[0]] @ turn.T + geom.pos)
            continue
        if geom.type[0] == mujoco.mjtGeom.mjGEOM_SPHERE:
            reach = np.full(3, size[0])
        elif geom.type[0] == mujoco.mjtGeom.mjGEOM_CYLINDER:
            assert np.allclose(turn, np.eye(3))
            reach = np.array([size[0], size[0], size[1]])
        else:
            reach = np.abs(turn) @ size
        points.append(np.stack([geom.pos - reach, geom.pos + reach]))
    everything = np.concatenate(points)
    return everything.min(axis=0), everything.max(axis=0)
