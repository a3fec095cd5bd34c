"""What can be wrong with an evaluation before it starts."""


class ExtrapolationError(ValueError):
    """There is nothing to evaluate, or a number of steps, seeds or lanes makes no sense."""
