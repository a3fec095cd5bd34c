"""From a lane to a picture: lights, walls cut away, marks of targets and goals, the camera."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from perdure.home.errors import HomeError
from perdure.home.sim.apartments import cut_away
from perdure.home.sim.arrays import FloatArray, Picture
from perdure.home.sim.world import Simulator
from perdure.home.video.cameras import FOVY, OWN, Shot, check_camera, whole_apartment
from perdure.home.video.marks import Mark
from perdure.home.video.words import write_labels
from perdure.render import open_context

LARGEST = 4096
NEAR = 0.02
"""Near clipping distance in [m]: the head looks along the upper arm."""
SHADOWS = 4096
"""Size of the shadow map in texels."""
SEEN = (1, 1, 1, 0, 0, 0)
"""Geom groups that are seen."""
PIN = 0.35
"""Height of an object's pin over it in [m]."""

FILL = ((0.8, 0.6, -0.12), (-0.8, -0.6, -0.12), (0.6, -0.8, -0.12), (-0.6, 0.8, -0.12))
"""Directions of the lights that brighten shadows."""
FILL_STRENGTH = 0.2


class Studio:
    """Takes pictures of one lane, many if need be. Use it in a `with`, in the thread that made it."""

    def __init__(self, simulator: Simulator, size: tuple[int, int] = (900, 600)) -> None:
        """Set up lights and camera.

        Args:
            simulator: What to take pictures of; its scene should be built with visuals. It is not changed.
            size: Width and height of the pictures in pixels.

        Raises:
            HomeError: If the size is none.
            RenderError: If no picture can be drawn on this machine.
        """
        import mujoco

        if not all(16 <= side <= LARGEST for side in size):
            raise HomeError(f"a picture must be 16 to {LARGEST} pixels wide and high, not {size[0]} x {size[1]}")
        self.simulator, self.size = simulator, size
        self._mujoco = mujoco
        self._model: Any = copy(simulator.model)  # walls are cut away in this one
        self._context = open_context(*size)
        _set_visuals(self._model, size)
        self._colors: NDArray[np.float32] = self._model.geom_rgba.copy()
        self._scene = mujoco.MjvScene(self._model, maxgeom=self._model.ngeom + 200)
        self._options = mujoco.MjvOption()
        self._options.geomgroup[:] = SEEN
        self._options.sitegroup[:] = 0
        self._drawing = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._drawing)

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(self, *error: object) -> None:
        """See `close`."""
        self.close()

    def close(self) -> None:
        """Give the graphics memory back."""
        if self._context is not None:
            self._drawing.free()
            self._context.free()
            self._context = None

    def take(self, camera: str | Shot, marks: Sequence[Mark] = ()) -> Picture:
        """Return one picture of the present lane.

        Args:
            camera: `doll_house`, `plan`, `head`, `hand`, `follow`, or a shot of one's own.
            marks: Targets and goals to show.
        """
        shot = self._shot(camera)
        if isinstance(shot, Shot):
            self._model.geom_rgba[:] = self._colors
            cut_away(self._model, self.simulator.scene.apartment, shot.eye)
        self._mujoco.mjv_updateScene(
            self._model,
            self.simulator.data,
            self._options,
            None,
            self._camera(shot),
            self._mujoco.mjtCatBit.mjCAT_ALL.value,
            self._scene,
        )
        self._add_fill_light()
        places = [self._object_place(mark) for mark in marks]
        for mark, place in zip(marks, places, strict=True):
            self._add_mark(mark, place)
        picture = self._read()
        if isinstance(shot, Shot) and marks:
            picture = write_labels(picture, shot, marks, places)
        return picture

    def _shot(self, camera: str | Shot) -> Shot | str:
        if isinstance(camera, Shot):
            return camera
        if check_camera(camera) in OWN:
            return camera
        if camera == "follow":
            from perdure.home.video.follow import Follower

            return Follower(self.simulator).shot()
        return whole_apartment(self.simulator.scene.apartment, camera, self.size)

    def _camera(self, shot: Shot | str) -> Any:
        camera = self._mujoco.MjvCamera()
        if isinstance(shot, str):
            camera.type = self._mujoco.mjtCamera.mjCAMERA_FIXED
            camera.fixedcamid = self._model.camera(shot).id
            return camera
        camera.type = self._mujoco.mjtCamera.mjCAMERA_FREE
        camera.azimuth, camera.elevation, camera.distance = shot.angles()
        camera.lookat[:] = shot.target
        return camera

    def _object_place(self, mark: Mark) -> FloatArray | None:
        """Return where a mark's object is now."""
        scene = self.simulator.scene
        if not 0 <= mark.number < len(scene.placements):
            return None
        address = scene.object_qpos[mark.number]
        return np.array(self.simulator.qpos[address : address + 3])

    def _add_mark(self, mark: Mark, place: FloatArray | None) -> None:
        kinds, goal = self._mujoco.mjtGeom, np.array(mark.goal)
        self._add(kinds.mjGEOM_SPHERE, (mark.radius,) * 3, goal, mark.color, 0.32)
        self._add(kinds.mjGEOM_SPHERE, (0.018,) * 3, goal, mark.color, 1.0)
        if place is not None:
            tip = place + np.array([0.0, 0.0, 0.13])
            self._add(
                kinds.mjGEOM_ARROW, (0.012, 0.012, PIN), tip + np.array([0.0, 0.0, PIN]), mark.color, 0.95, down=True
            )

    def _add(
        self, kind: Any, size: Sequence[float], place: FloatArray, color: Any, alpha: float, down: bool = False
    ) -> None:
        scene = self._scene
        if scene.ngeom >= scene.maxgeom:
            return
        turned = np.diag([1.0, -1.0, -1.0]) if down else np.eye(3)
        rgba = np.array([*color, alpha], dtype=np.float32)
        geom = scene.geoms[scene.ngeom]
        self._mujoco.mjv_initGeom(geom, kind, np.array(size), place, turned.ravel(), rgba)
        geom.category = self._mujoco.mjtCatBit.mjCAT_DECOR
        geom.emission, geom.specular = 0.35, 0.0
        scene.ngeom += 1

    def _add_fill_light(self) -> None:
        """Light without shadows from two sides, or walls that look away from sun and camera would be gray."""
        lights, count = self._scene.lights, self._scene.nlight
        for number, direction in enumerate(FILL):
            if count + number < len(lights):
                light = lights[count + number]
                light.dir[:] = direction
                light.type, light.castshadow, light.headlight = self._mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, 0, 0
                light.ambient[:], light.diffuse[:], light.specular[:] = 0.0, FILL_STRENGTH, 0.0
                self._scene.nlight += 1

    def _read(self) -> Picture:
        self._context.make_current()
        width, height = self.size
        picture = np.empty((height, width, 3), dtype=np.uint8)
        viewport = self._mujoco.MjrRect(0, 0, width, height)
        self._mujoco.mjr_render(viewport, self._scene, self._drawing)
        self._mujoco.mjr_readPixels(picture, None, viewport, self._drawing)
        return np.ascontiguousarray(picture[::-1])


def render_lane(
    simulator: Simulator,
    camera: str | Shot = "doll_house",
    size: tuple[int, int] = (900, 600),
    goals: Sequence[Mark] = (),
) -> Picture:
    """Return one picture of a lane, shape (height, width, 3). For many of the same lane, a `Studio` is faster.

    Arguments as of `Studio` and `Studio.take`.
    """
    with Studio(simulator, size) as studio:
        return studio.take(camera, goals)


def _set_visuals(model: Any, size: tuple[int, int]) -> None:
    model.vis.global_.fovy = FOVY
    model.vis.global_.offwidth, model.vis.global_.offheight = size
    model.vis.quality.shadowsize = SHADOWS
    model.vis.map.znear = NEAR / model.stat.extent  # MuJoCo counts it in sizes of the model
    model.vis.headlight.ambient[:], model.vis.headlight.diffuse[:] = 0.42, 0.14
