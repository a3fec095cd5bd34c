"""The report's own exception."""


class ReportError(ValueError):
    """A table or a request cannot be reported on; the message names the thing and says why."""
