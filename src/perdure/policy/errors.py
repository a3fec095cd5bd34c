"""What can be wrong with a policy or with what it is asked."""


class PolicyError(ValueError):
    """A policy is asked to act on something that does not fit it."""


class PolicyFileError(PolicyError):
    """A file is not a policy of this library, is damaged, or was changed after it was written."""


class PolicyWarning(UserWarning):
    """A policy can be read, but what is said about it is unusual and perhaps a mistake."""
