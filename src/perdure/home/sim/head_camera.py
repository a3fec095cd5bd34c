"""Depth images of the robot's head camera."""

from __future__ import annotations

import atexit
import weakref
from copy import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perdure.errors import PerdureError
from perdure.film import open_context
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.simulator import Simulator

DepthImage = NDArray[np.float32]

SIDE = 128
"""Width and height of an image in pixels (M3, `configs/rearrange/tasks/__base__.py`)."""
FAR = 10.0
"""Largest depth that is distinguished in [m] (M3, the same file)."""
NEAR = 0.01
"""Smallest depth that is drawn in [m] (habitat-sim's default, `src/esp/sensor/VisualSensor.h`)."""
LARGEST = 4096
"""Largest width and height in pixels."""
DRAWN_GROUPS = (1, 1, 0, 1, 0, 0)
"""Geom groups that are drawn: everything that collides, see `perdure.home.sim.geoms`."""


class HeadCamera:
    """Takes depth images of lanes, of any number of scenes. Use it in the thread that made it.

    The camera is `ROBOT.head_camera`: with the torso at 0.15 m it looks from (0.17, 0, 1.2) to (0.75, 0, 1.0) in the
    base frame, 19 degrees down, as in M3 (`habitat_extensions/robots/fetch_robot.py`). That is 8 mm from where Fetch
    Robotics' `fetch.urdf` has `head_camera_link` when the head is tilted so: in torso_lift_link (0.053125, 0, 0.603001)
    + (0.14253, 0, 0.057999) + R_y(0.332) (0.055, 0, 0.0225). It rides on base and torso; the head does not turn. The
    field of view is 90 degrees both ways (M3).
    """

    def __init__(self, side: int = SIDE) -> None:
        """Open an OpenGL context.

        Args:
            side: Width and height of the images in pixels.

        Raises:
            PerdureError: If the size is not allowed, or this machine cannot render.
        """
        import mujoco

        if not 1 <= side <= LARGEST:
            raise PerdureError(f"a depth image must be 1 to {LARGEST} pixels wide and high, not {side}")
        self.side = side
        self._mujoco = mujoco
        self._gl = open_context(side, side)
        self._drawings: dict[bytes, Any] = {}
        self._scene: Any = None
        self._options = mujoco.MjvOption()
        self._options.flags[mujoco.mjtVisFlag.mjVIS_TEXTURE] = 0
        self._options.geomgroup[:] = DRAWN_GROUPS
        self._free = weakref.finalize(self, _free, self._gl, self._drawings)
        atexit.register(self._free)  # EGL ends itself at exit; what was registered last runs first

    def take(self, simulator: Simulator) -> DepthImage:
        """Return one image of a lane in its present state; its physics is not changed.

        Returns:
            Depth in [m] along the camera's axis (planar, not the length of the ray) from 0.01 to 10, with 10 for
            whatever is farther and for nothing (habitat-sim: 0 for nothing). The upper left pixel comes first.
            Shape (side, side).
        """
        mujoco = self._mujoco
        model = simulator.model
        data = simulator.data
        self._gl.make_current()
        drawing = self._drawing(model)
        self._update_scene(model, data)
        depth = np.empty((self.side, self.side), dtype=np.float32)
        viewport = mujoco.MjrRect(0, 0, self.side, self.side)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, drawing)  # another one may be bound
        mujoco.mjr_render(viewport, self._scene, drawing)
        mujoco.mjr_readPixels(None, depth, viewport, drawing)
        # MuJoCo's buffer runs from 1 at the near plane to 0 at the far one, linear in 1 / depth.
        meters = NEAR * FAR / (NEAR + depth[::-1].astype(np.float64) * (FAR - NEAR))
        return meters.astype(np.float32)

    def close(self) -> None:
        """Free the graphics memory."""
        self._free()
        atexit.unregister(self._free)

    def _update_scene(self, model: Any, data: Any) -> None:
        """Put a lane's geoms and the camera into the scene."""
        mujoco = self._mujoco
        if self._scene is None or self._scene.maxgeom < model.ngeom:
            self._scene = mujoco.MjvScene(model, maxgeom=2 * model.ngeom)
            self._scene.flags[:] = 0
            for flag in ("CULL_FACE", "SEGMENT", "IDCOLOR"):  # no light, no colors: 40 % less time
                self._scene.flags[getattr(mujoco.mjtRndFlag, f"mjRND_{flag}")] = 1
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        camera.fixedcamid = model.camera(ROBOT.head_camera).id
        bodies = mujoco.mjtCatBit.mjCAT_STATIC.value | mujoco.mjtCatBit.mjCAT_DYNAMIC.value
        mujoco.mj_camlight(model, data)  # a step leaves cameras where they were before its last physics step
        mujoco.mjv_updateScene(model, data, self._options, None, camera, bodies, self._scene)
        for eye in self._scene.camera:  # the model's own planes depend on the apartment's size
            eye.frustum_near = NEAR
            eye.frustum_far = FAR
            eye.frustum_top = NEAR
            eye.frustum_bottom = -NEAR

    def _drawing(self, model: Any) -> Any:
        """Return MuJoCo's drawing context of a model. It depends on the meshes only, and only the bowl is one."""
        meshes = model.mesh_vert.tobytes() + model.mesh_face.tobytes()
        if meshes not in self._drawings:
            mujoco = self._mujoco
            plain = copy(model)
            plain.vis.global_.offwidth = self.side
            plain.vis.global_.offheight = self.side
            plain.vis.quality.offsamples = 0
            plain.vis.quality.shadowsize = 0
            plain.vis.quality.numquads = 1
            drawing = mujoco.MjrContext(plain, mujoco.mjtFontScale.mjFONTSCALE_50.value)
            drawing.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
            self._drawings[meshes] = drawing
        return self._drawings[meshes]


def _free(context: Any, drawings: dict[bytes, Any]) -> None:
    """Each context frees its own: MuJoCo deletes by number in whichever is current."""
    context.make_current()
    while drawings:
        drawings.popitem()[1].free()
    context.free()
