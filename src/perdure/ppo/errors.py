"""Errors of training settings and checkpoints."""


class ConfigError(ValueError):
    """A setting of the learner is out of range, or a method or preset is unknown."""


class CheckpointError(ValueError):
    """A checkpoint is damaged, or belongs to another run."""
