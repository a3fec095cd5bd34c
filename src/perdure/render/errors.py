"""Error of this package."""


class RenderError(ValueError):
    """Nothing can be drawn, or a film cannot be written."""
