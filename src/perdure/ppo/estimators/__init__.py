"""Advantage estimators by name. A new one is a file here and a line in ESTIMATORS.

An estimator is written `name` or `name:number=value,...`, such as `average-reward:reset_cost=10`; the numbers are the
fields of its class.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable
from typing import TYPE_CHECKING

from perdure.ppo.errors import ConfigError
from perdure.ppo.estimators.average_reward import AverageReward
from perdure.ppo.estimators.discounted import Discounted
from perdure.ppo.estimators.estimator import Ends, Estimate, Estimator, State, Transitions

if TYPE_CHECKING:
    from perdure.ppo.config import PPOConfig

ESTIMATORS: dict[str, Callable[..., Estimator]] = {"discounted": Discounted.of, "average-reward": AverageReward.of}
"""Name to a function (config, **numbers) -> Estimator."""


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
    numbers: dict[str, float] = {}
    for part in text.split(",") if text else []:
        key, _, value = part.partition("=")
        try:
            numbers[key] = float(value)
        except ValueError:
            raise ConfigError(f"{part!r} in estimator {config.estimator!r} must be written name=number") from None
    try:
        return ESTIMATORS[name](config, **numbers)
    except TypeError as error:
        raise ConfigError(f"estimator {config.estimator!r}: {error}") from None


__all__ = ["ESTIMATORS", "Ends", "Estimate", "Estimator", "State", "Transitions", "make_estimator"]
