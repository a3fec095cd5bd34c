"""From an apartment record to a MuJoCo model: boxes for furniture, joints for drawers and the fridge's door.

Names in the model: a piece is a body of its name (`sofa`), a moving part a body, joint and site named after its link,
joint and handle (`drawer2_top`, `middle_slide_top`, `cab_push_point_5`); a geom is `piece/solid` or
`piece/link/solid`.

Geom groups: 0 collides and is visible, 1 walls, 2 visual only, 3 collision only. Sites of handles are in group 4.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from perdure.home.sim.apartments.piece import Apartment, Articulation, Piece, Solid

if TYPE_CHECKING:
    import mujoco

PALETTE: dict[str, tuple[float, float, float, float]] = {
    "floor": (0.80, 0.72, 0.62, 1.0),
    "floor_dark": (0.76, 0.68, 0.58, 1.0),
    "wall": (0.93, 0.91, 0.87, 1.0),
    "oak": (0.72, 0.56, 0.40, 1.0),
    "walnut": (0.45, 0.33, 0.25, 1.0),
    "white": (0.92, 0.92, 0.90, 1.0),
    "front": (0.66, 0.71, 0.66, 1.0),
    "stone": (0.55, 0.54, 0.53, 1.0),
    "steel": (0.70, 0.72, 0.74, 1.0),
    "handle": (0.32, 0.33, 0.35, 1.0),
    "fridge": (0.80, 0.82, 0.83, 1.0),
    "glass": (0.80, 0.88, 0.90, 0.45),
    "fabric": (0.44, 0.52, 0.58, 1.0),
    "cushion": (0.56, 0.63, 0.68, 1.0),
    "ochre": (0.77, 0.62, 0.38, 1.0),
    "terracotta": (0.70, 0.46, 0.36, 1.0),
    "leaf": (0.40, 0.52, 0.38, 1.0),
    "rug": (0.74, 0.66, 0.60, 1.0),
    "screen": (0.12, 0.13, 0.15, 1.0),
    "picture": (0.62, 0.66, 0.64, 1.0),
    "lamp": (0.95, 0.90, 0.78, 1.0),
}
"""Colors (red, green, blue, alpha), each in [0, 1], by name."""
GROUPS = {"solid": 0, "wall": 1, "look": 2, "hull": 3, "handle": 4}
FRICTION = (0.2, 0.005, 0.0001)
"""Friction of furniture: low, because MuJoCo takes the larger one of a pair and the object's own is to decide."""


def build_apartment(
    apartment: Apartment, spec: mujoco.MjSpec | None = None, *, visuals: bool = True, damping_scale: float = 1.0
) -> mujoco.MjSpec:
    """Add an apartment to a MuJoCo specification.

    Args:
        apartment: What to build.
        spec: Where to add it; a new one when None. Options such as the timestep are left alone.
        visuals: Whether visual geometry is built (False makes a smaller model for training).
        damping_scale: Factor on the damping of drawers and doors.

    Returns:
        The specification, not compiled.
    """
    import mujoco

    spec = mujoco.MjSpec() if spec is None else spec
    _add_floor(spec, apartment)
    for piece in (*apartment.walls, *apartment.pieces):
        _add_piece(spec, piece, visuals, damping_scale)
    if visuals:
        _add_light(spec, apartment)
        _add_cameras(spec, apartment)
    return spec


def _add_floor(spec: Any, apartment: Apartment) -> None:
    import mujoco

    spec.add_texture(
        name="floor",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=PALETTE["floor"][:3],
        rgb2=PALETTE["floor_dark"][:3],
        width=256,
        height=256,
    )
    material = spec.add_material(name="floor", texrepeat=(1.25, 1.25), texuniform=True)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "floor"
    low, high = np.min(apartment.room, axis=0), np.max(apartment.room, axis=0)
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=(*(0.5 * (low + high)), 0.0),
        size=(*(0.5 * (high - low) + 0.1), 0.05),
        material="floor",
        friction=FRICTION,
    )


def _add_piece(spec: Any, piece: Piece, visuals: bool, damping_scale: float) -> None:
    half_yaw = 0.5 * piece.pose.yaw
    body = spec.worldbody.add_body(
        name=piece.name, pos=(piece.pose.x, piece.pose.y, 0.0), quat=(math.cos(half_yaw), 0.0, 0.0, math.sin(half_yaw))
    )
    for solid in piece.solids:
        _add_solid(body, f"{piece.name}/{solid.name}", solid, visuals, "wall" if piece.kind == "wall" else None)
    for moving in piece.articulations:
        _add_articulation(spec, body, piece, moving, visuals, damping_scale)


def _add_solid(body: Any, name: str, solid: Solid, visuals: bool, group: str | None = None) -> None:
    import mujoco

    if solid.role == "look" and not visuals:
        return
    collides = int(solid.role != "look")
    body.add_geom(
        name=name,
        type=getattr(mujoco.mjtGeom, f"mjGEOM_{solid.shape.upper()}"),
        pos=solid.center,
        size=(solid.half[0], solid.half[2], 0.0) if solid.shape == "cylinder" else solid.half,
        rgba=PALETTE[solid.color],
        group=GROUPS[group or solid.role],
        contype=collides,
        conaffinity=collides,
        friction=FRICTION,
        mass=0.0,
    )


def _add_articulation(
    spec: Any, parent: Any, piece: Piece, moving: Articulation, visuals: bool, damping_scale: float
) -> None:
    import mujoco

    body = parent.add_body(name=moving.link, pos=moving.origin)
    center, inertia = _box_inertia(moving)
    body.mass, body.ipos, body.inertia, body.explicitinertial = moving.mass, center, inertia, True
    hinge = moving.kind == "hinge"
    joint = body.add_joint(
        name=moving.joint,
        type=mujoco.mjtJoint.mjJNT_HINGE if hinge else mujoco.mjtJoint.mjJNT_SLIDE,
        axis=moving.axis,
        limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        range=np.degrees(moving.limit) if hinge and spec.compiler.degree else moving.limit,
    )
    damping = moving.damping * damping_scale
    joint.damping = damping if np.ndim(joint.damping) == 0 else [damping, 0.0, 0.0]  # a vector since MuJoCo 3.7
    for solid in moving.solids:
        _add_solid(body, f"{piece.name}/{moving.link}/{solid.name}", solid, visuals)
    body.add_site(name=moving.handle_name, pos=moving.handle, size=(0.02, 0.02, 0.02), group=GROUPS["handle"])
    spec.add_exclude(bodyname1=piece.name, bodyname2=moving.link)


def _box_inertia(moving: Articulation) -> tuple[np.ndarray, np.ndarray]:
    """Return middle and principal moments of a solid box that spans the part's colliding solids."""
    solids = [s for s in moving.solids if s.role != "look"]
    low = np.min([np.array(s.center) - s.half for s in solids], axis=0)
    high = np.max([np.array(s.center) + s.half for s in solids], axis=0)
    square = (high - low) ** 2
    return 0.5 * (low + high), moving.mass / 12.0 * (square.sum() - square)


def _add_light(spec: Any, apartment: Apartment) -> None:
    import mujoco

    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = (0.42, 0.42, 0.42), (0.32, 0.32, 0.32)
    spec.visual.headlight.specular = (0.05, 0.05, 0.05)
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=(0.93, 0.94, 0.95),
        rgb2=(0.78, 0.81, 0.84),
        width=64,
        height=384,
    )
    spec.worldbody.add_light(
        name="sun",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=(*np.mean(apartment.room, axis=0), 6.0),
        dir=(0.12, 0.16, -1.0),
        diffuse=(0.38, 0.37, 0.35),
        specular=(0.05, 0.05, 0.05),
        castshadow=True,
    )


def _add_cameras(spec: Any, apartment: Apartment) -> None:
    """`plan` looks straight down, `doll_house` at the kitchen's front from above."""
    low, high = np.min(apartment.room, axis=0), np.max(apartment.room, axis=0)
    middle, (width, depth) = 0.5 * (low + high), high - low
    distance = max(depth, 0.75 * width) / (2.0 * math.tan(math.radians(22.5))) + 0.5
    spec.worldbody.add_camera(name="plan", pos=(*middle, distance), fovy=45.0)
    yaw = next((p.pose.yaw for p in apartment.pieces if p.kind == "kitchen_counter"), math.pi / 2.0)
    away = 0.95 * max(width, depth) * np.array([math.cos(yaw), math.sin(yaw), 0.0])
    target = np.array([*middle, 0.2])
    _look_at(spec, "doll_house", target + away + [0.0, 0.0, 0.95 * max(width, depth)], target)


def _look_at(spec: Any, name: str, eye: np.ndarray, target: np.ndarray) -> None:
    """A camera at `eye` that looks at `target`, the horizon level."""
    import mujoco

    backward = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross((0.0, 0.0, 1.0), backward)
    right /= np.linalg.norm(right)
    up = np.cross(backward, right)
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, np.stack([right, up, backward], axis=1).ravel())
    spec.worldbody.add_camera(name=name, pos=eye, quat=quat, fovy=45.0)


def cut_away(model: Any, apartment: Apartment, eye: NDArray[np.float64]) -> None:
    """Make the walls (and the pictures on them) between a camera at `eye` (3,) and the room invisible.

    Colors of the compiled model are changed in place.
    """
    for piece in (*apartment.walls, *apartment.pieces):
        if piece.kind not in ("wall", "picture") or piece.name.startswith("partition"):
            continue
        facing = piece.pose.yaw + (np.pi / 2.0 if piece.kind == "wall" else 0.0)  # direction of its room side
        if (eye[0] - piece.pose.x) * np.cos(facing) + (eye[1] - piece.pose.y) * np.sin(facing) < 0.0:
            for solid in piece.solids:
                model.geom(f"{piece.name}/{solid.name}").rgba[3] = 0.0
