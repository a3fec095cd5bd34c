"""Measure how much the action depends on the time-to-go input.

In visited states the policy is asked what it would do with C steps to go in an episode of 1,000. The change is
|action(C) - action(500)|, averaged over states and components, as a share of the width of the action box.
"""

from __future__ import annotations

import numpy as np
import polars as pl

from perdure.policy import Policy
from perdure.studies.horizon.rollouts import FloatArray, Rollout, thinned

ASKED = tuple(range(0, 1001, 100))
OWN = 500
"""The C that others are compared with."""
MOST_STATES = 400


def action_changes(policy: Policy, rollout: Rollout) -> pl.DataFrame:
    """Return the mean change of the action for each C: columns "C", "change"."""
    states = thinned(rollout, MOST_STATES)
    width = np.asarray(policy.task.action_high) - np.asarray(policy.task.action_low)
    own = _actions(policy, states, OWN)
    changes = [float((np.abs(_actions(policy, states, c) - own) / width).mean()) for c in ASKED]
    return pl.DataFrame({"C": list(ASKED), "change": changes})


def _actions(policy: Policy, states: FloatArray, steps: int) -> FloatArray:
    # Not phi(0, C): the linear embedding is 1 there for every C.
    horizons = np.full(len(states), float(ASKED[-1]))
    return policy.act_at(states, horizons - steps, horizons)
