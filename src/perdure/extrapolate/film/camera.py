"""Pictures of a MuJoCo simulation, with or without a display."""

from __future__ import annotations

from copy import copy
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from perdure.render import open_context

Picture = NDArray[np.uint8]
"""Shape (height, width, 3)."""

BODY = 1
"""The camera follows the first body after the world, the robot's torso, unless the environment says otherwise."""
AZIMUTH, ELEVATION = 90.0, -15.0
"""From the side on which Gymnasium's robots run to the right, in degrees."""


class Camera:
    """A camera that follows the robot of one environment. Use it as a context manager in the thread that made it."""

    def __init__(self, env: Any, size: tuple[int, int]) -> None:
        """Open an OpenGL context.

        Args:
            env: A MuJoCo environment of Gymnasium.
            size: Width and height in pixels.

        Raises:
            RenderError: If nothing can be rendered on this machine.
        """
        import mujoco

        self._mujoco, self.size = mujoco, size
        self._model, self._data = copy(env.unwrapped.model), env.unwrapped.data
        _widen_floor(self._model, mujoco.mjtGeom.mjGEOM_PLANE.value)
        visual = self._model.vis
        visual.global_.offwidth, visual.global_.offheight = size
        visual.quality.shadowsize = 1024
        self._context = open_context(*size)
        self._drawing = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._drawing)
        self._scene = mujoco.MjvScene(self._model, maxgeom=self._model.ngeom + 200)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION.value] = 0  # half of the time on a processor
        self._options = mujoco.MjvOption()
        self._camera = self._follow(getattr(env.unwrapped.mujoco_renderer, "default_cam_config", None) or {})

    def _follow(self, config: dict[str, Any]) -> Any:
        camera = self._mujoco.MjvCamera()
        camera.type = self._mujoco.mjtCamera.mjCAMERA_TRACKING.value
        camera.trackbodyid = int(config.get("trackbodyid", BODY))
        camera.distance = float(config.get("distance", 1.5 * self._model.stat.extent))
        camera.azimuth, camera.elevation = AZIMUTH, ELEVATION
        return camera

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Release the graphics memory."""
        self._context.make_current()
        self._drawing.free()
        self._context.free()

    def take(self) -> Picture:
        """Return a picture of the simulation as it is now."""
        m = self._mujoco
        self._context.make_current()
        m.mjv_updateScene(
            self._model, self._data, self._options, None, self._camera, m.mjtCatBit.mjCAT_ALL.value, self._scene
        )
        width, height = self.size
        picture: Picture = np.empty((height, width, 3), np.uint8)
        view = m.MjrRect(0, 0, width, height)
        m.mjr_render(view, self._scene, self._drawing)
        m.mjr_readPixels(picture, None, view, self._drawing)
        return np.ascontiguousarray(picture[::-1])


def _widen_floor(model: Any, plane: int) -> None:
    """Draw floors without an edge, as in the simulation: robots run far. Their texture repeats every meter."""
    floors = model.geom_type == plane
    model.geom_size[floors, :2] = 0.0
    materials = model.geom_matid[floors]
    model.mat_texuniform[materials[materials >= 0]] = 1
    model.mat_texrepeat[materials[materials >= 0]] = 1.0
