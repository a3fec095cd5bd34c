"""Errors of embeddings, clocks, horizon distributions and protocols."""


class HorizonError(ValueError):
    """An embedding, a clock, a distribution of the horizon or a protocol is invalid."""
