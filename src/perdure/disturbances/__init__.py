"""Disturbances of a robot, declared like clocks: ``action_noise:0.1``, ``push:0.5``, ``strength:0.5@2000+500``.

A kind of disturbance is a subclass of `Effect`: it is found by its name as soon as it is defined, also in another
package (see `perdure.registry`). `Disturbance` is what a command line declares, and `Disturber` applies it.

What an episode meets depends on its seed, the disturbance and the step alone: policies that start from the same seed
meet the same draws, whatever runs beside them. `perdure.envs.disturbances.DisturbedWorld` applies disturbances to a
world, and `perdure.wrappers.Disturb` to an environment of Gymnasium.
"""

from perdure.disturbances.disturber import Disturber
from perdure.disturbances.kinds import Noise, root_velocity
from perdure.disturbances.vocabulary import (
    CALM,
    STANDARD,
    STANDARDS,
    Disturbance,
    Effect,
    Robots,
    applied_disturbances,
    check_onsets,
    examples,
    labels,
    neutral_level,
    parse_disturbance,
    parse_disturbances,
    split_text,
)

__all__ = [
    "CALM",
    "STANDARD",
    "STANDARDS",
    "Disturbance",
    "Disturber",
    "Effect",
    "Noise",
    "Robots",
    "applied_disturbances",
    "check_onsets",
    "examples",
    "labels",
    "neutral_level",
    "parse_disturbance",
    "parse_disturbances",
    "root_velocity",
    "split_text",
]
