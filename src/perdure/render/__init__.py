"""Pictures without a window and films as files: what films of locomotion and of the home share."""

from perdure.render.errors import RenderError
from perdure.render.mp4 import Mp4Writer
from perdure.render.opengl import open_context

__all__ = ["Mp4Writer", "RenderError", "open_context"]
