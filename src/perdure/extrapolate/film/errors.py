"""Why there is no film."""


class FilmError(ValueError):
    """A film cannot be made here, or there is nothing to show."""
