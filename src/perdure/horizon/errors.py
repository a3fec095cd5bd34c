"""What can be wrong with a statement about time."""


class HorizonError(ValueError):
    """An embedding, a clock, a distribution of the horizon or a protocol that contradicts itself."""
