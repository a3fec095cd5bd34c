"""The package's own exceptions."""


class StoreError(ValueError):
    """A unit cannot be stored or found as asked; the message names the unit and says why."""


class UnitBusyError(StoreError):
    """Another process is at work on the unit."""


class RunError(ValueError):
    """Units failed. The message names the first one and its error; the store keeps a record of each."""


class OtherSourceWarning(UserWarning):
    """Finished units were made by other source code of perdure and are reused as they are."""
