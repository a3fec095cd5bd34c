"""Errors of videos."""


class FilmError(ValueError):
    """A film cannot be made here, or there is nothing to show."""
