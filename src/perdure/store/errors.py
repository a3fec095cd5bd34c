"""The store's own exception."""


class StoreError(ValueError):
    """A unit cannot be stored or found as asked; the message names the unit and says why."""


class OtherSourceWarning(UserWarning):
    """Finished units that are taken as they are were made by other source code of perdure."""
