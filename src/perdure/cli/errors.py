"""What can be wrong with a command line beyond its single flags."""


class CommandError(ValueError):
    """Arguments that do not fit together."""
