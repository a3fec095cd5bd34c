"""What can be wrong with the content of a file."""


class SchemaError(ValueError):
    """A value does not fit what is declared for it; the message names its place, the value and what is allowed."""
