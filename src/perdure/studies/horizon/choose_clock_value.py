"""Choose C without a sweep, by the critic: the C with the largest predicted reward per remaining step.

The critic was trained as V(s, steps to go). For states s that the policy visits in a short rollout, V(s, C) / C is the
reward rate it expects of the next C steps. The C with the highest mean is taken.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from perdure.horizon import Constant
from perdure.policy import Policy
from perdure.studies.horizon.rollouts import FIRST_SEED, FloatArray, roll_out, thinned
from perdure.studies.horizon.rule_choice import RuleChoice

LANES, STEPS = 4, 1000
"""Of the rollout under the policy's own clock."""
MOST_STATES = 400


def choose_by_value(policy: Policy, candidates: Sequence[Constant], first_seed: int = FIRST_SEED) -> RuleChoice:
    """Return the candidate with the highest mean V(s, C) / C over visited states; of equals the first one.

    Args:
        policy: With a time-to-go input and a critic.
        candidates: Each with C > 0.
        first_seed: World seed of the first start state.
    """
    rollout = roll_out(policy, [policy.clock] * LANES, STEPS, first_seed)
    states = thinned(rollout, MOST_STATES)
    scores = {clock: float((_value(policy, states, clock) / float(clock.steps)).mean()) for clock in candidates}
    return RuleChoice("value", max(scores, key=lambda clock: scores[clock]), scores, rollout.lane_steps)


def _value(policy: Policy, states: FloatArray, clock: Constant) -> FloatArray:
    elapsed, horizon = clock.time(np.zeros(len(states)))
    return policy.scaled_value(states, elapsed, horizon)
