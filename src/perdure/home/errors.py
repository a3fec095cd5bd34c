"""Errors in the arguments of the home benchmark."""

from __future__ import annotations


class HomeError(ValueError):
    """Wrong input to `perdure.home`: the message names the argument, the bad value and the valid ones."""
