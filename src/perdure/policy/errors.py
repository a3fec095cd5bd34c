"""Errors and warnings of policies."""


class PolicyError(ValueError):
    """A policy does not fit the world, the observations or the clock."""


class PolicyFileError(PolicyError):
    """A file is not a policy of this library, is damaged, or was changed after it was written."""


class PolicyWarning(UserWarning):
    """A policy can be read, but its description is unusual and perhaps wrong."""
