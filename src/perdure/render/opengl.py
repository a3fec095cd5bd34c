"""An OpenGL context without a window: EGL (the graphics card, or Mesa) or else OSMesa (the processor)."""

from __future__ import annotations

import os
import sys
from importlib import import_module
from typing import Any

from perdure.render.errors import RenderError

OFF = ("disable", "disabled", "off", "false", "0")
"""Values of MUJOCO_GL that switch rendering off."""


def open_context(width: int, height: int) -> Any:
    """Return an OpenGL context that is current in this thread, for pictures up to a size in pixels.

    MUJOCO_GL decides if it is `egl`, `osmesa` or `glfw`; else, on Linux, the first of EGL and OSMesa that works.

    Raises:
        RenderError: If none of them works here, or MUJOCO_GL switches pictures off.
    """
    failures = []
    for name in _candidates():
        try:
            context = _context_class(name)(width, height)
            context.make_current()
        except Exception as error:  # every driver has its own way to fail
            failures.append(f"{name} ({_first_line(error)})")
            _forget_opengl()
        else:
            return context
    raise RenderError(f"no picture can be drawn here: {'; '.join(failures)}; on Debian, install libegl1 or libosmesa6")


def _candidates() -> tuple[str, ...]:
    wanted = os.environ.get("MUJOCO_GL", "").lower().strip()
    if wanted in OFF:
        raise RenderError(f"no picture can be drawn: MUJOCO_GL={wanted} switches pictures off")
    if wanted in ("egl", "osmesa", "glfw"):
        return (wanted,)
    return ("egl", "osmesa") if sys.platform.startswith("linux") else ("default",)


def _context_class(name: str) -> Any:
    if name != "default":
        return import_module(f"mujoco.{name}").GLContext
    import mujoco

    return mujoco.GLContext


def _forget_opengl() -> None:
    """PyOpenGL binds to one platform when it is first imported; the next candidate needs another one."""
    os.environ.pop("PYOPENGL_PLATFORM", None)
    for module in [
        name for name in sys.modules if name.partition(".")[0] == "OpenGL" or name.startswith(_GL_OF_MUJOCO)
    ]:
        del sys.modules[module]


_GL_OF_MUJOCO = ("mujoco.egl", "mujoco.osmesa", "mujoco.glfw")


def _first_line(error: Exception) -> str:
    lines = str(error).split("\n")
    return f"{type(error).__name__}: {lines[0].strip()}"[:120]
