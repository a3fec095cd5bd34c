"""Exceptions and warnings of the package."""


class StoreError(ValueError):
    """A unit cannot be stored or found as asked; the message names the unit and says why."""


class UnitBusyError(StoreError):
    """Another process is running the unit."""


class RunError(ValueError):
    """Units failed. The message names the first one and its error; the store keeps a record of each."""


class OtherSourceWarning(UserWarning):
    """Finished units were made by another version of perdure's source code and are reused."""
