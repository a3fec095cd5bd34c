"""Errors in a command line that concern several flags."""


class CommandError(ValueError):
    """Arguments that do not fit together."""
