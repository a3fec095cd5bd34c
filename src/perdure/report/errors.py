"""Errors of reports."""


class ReportError(ValueError):
    """A table or an argument is invalid; the message names it and says why."""
