"""Errors of studies."""


class StudyError(ValueError):
    """A study, a scale, a claim or a table is invalid. The message says what to do."""
