"""Advantage estimators by name. A new one is a file here and a line in ESTIMATORS.

An estimator is written `name` or `name:number=value,...`, such as `average-reward:reset_cost=10`; the numbers are the
fields of its class that have a default.
"""

from __future__ import annotations

import difflib
from dataclasses import MISSING, fields
from typing import TYPE_CHECKING, Any

from perdure.ppo.errors import ConfigError
from perdure.ppo.estimators.average_reward import AverageReward
from perdure.ppo.estimators.discounted import Discounted
from perdure.ppo.estimators.estimator import Ends, Estimate, Estimator, State, Transitions

if TYPE_CHECKING:
    from perdure.ppo.config import PPOConfig

ESTIMATORS: dict[str, type[Any]] = {"discounted": Discounted, "average-reward": AverageReward}
"""Name to a dataclass whose `of` (config, **numbers) returns an `Estimator`."""


def make_estimator(config: PPOConfig) -> Estimator:
    """Return the estimator that a configuration names.

    Raises:
        ConfigError: If there is no such estimator, or it has no such number.
    """
    name, _, text = config.estimator.partition(":")
    if name not in ESTIMATORS:
        near = difflib.get_close_matches(name, ESTIMATORS, n=1)
        hint = f" (did you mean {near[0]!r}?)" if near else ""
        raise ConfigError(f"unknown estimator {name!r}{hint}; the estimators are {', '.join(ESTIMATORS)}")
    valid = [each.name for each in fields(ESTIMATORS[name]) if each.default is not MISSING]
    numbers: dict[str, float] = {}
    for part in text.split(",") if text else []:
        key, _, value = part.partition("=")
        if key not in valid:
            known = f"the numbers of {name} are {', '.join(valid)}" if valid else f"{name} has no numbers"
            raise ConfigError(f"unknown number {key!r} in estimator {config.estimator!r}; {known}")
        try:
            numbers[key] = float(value)
        except ValueError:
            raise ConfigError(f"{part!r} in estimator {config.estimator!r} must be written name=number") from None
    estimator: Estimator = ESTIMATORS[name].of(config, **numbers)
    return estimator


__all__ = ["ESTIMATORS", "Ends", "Estimate", "Estimator", "State", "Transitions", "make_estimator"]
