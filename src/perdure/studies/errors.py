"""The studies' own error."""


class StudyError(ValueError):
    """A study, a scale, a claim or a table that does not make sense. The message says what to do."""
