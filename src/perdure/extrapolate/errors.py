"""Errors in the arguments of an evaluation."""


class ExtrapolationError(ValueError):
    """There is nothing to evaluate, or a number of steps, seeds or lanes makes no sense."""
