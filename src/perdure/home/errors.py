"""What goes wrong at the door of the home benchmark."""

from __future__ import annotations


class HomeError(ValueError):
    """Wrong input to `perdure.home`: the message names the thing, the bad value and the valid ones."""
