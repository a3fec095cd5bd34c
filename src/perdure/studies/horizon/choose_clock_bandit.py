"""Choose C without a sweep: successive halving over clocks with short rollouts.

Every candidate runs from a few start states for a short time; the better half runs again from new start states, twice
as long, and so on until one is left [Karnin, Koren and Somekh, 2013, "Almost Optimal Exploration in Multi-Armed
Bandits"; Jamieson and Talwalkar, 2016]. The score is the return divided by the steps asked for, so a fall costs.
"""

from __future__ import annotations

from collections.abc import Sequence

from perdure.extrapolate import LaneSpec, evaluate_lanes
from perdure.horizon import Constant
from perdure.policy import Policy
from perdure.studies.horizon.rule_choice import RuleChoice

LANES = 2
"""Start states of each candidate in each round."""
FIRST_STEPS = 500
"""Steps in the first round."""
FIRST_EVAL_SEED = 4000
"""Start states that no split uses."""


def choose_by_halving(policy: Policy, candidates: Sequence[Constant], most_steps: int) -> RuleChoice:
    """Return the candidate that is left.

    Args:
        policy: With a time-to-go input.
        candidates: At least one, by rising C; of equally good ones the first stays.
        most_steps: No rollout is longer.
    """
    left = list(candidates)
    scores: dict[Constant, float] = {}
    steps, seed, made = min(FIRST_STEPS, most_steps), FIRST_EVAL_SEED, 0
    while len(left) > 1:
        lanes = [LaneSpec(0, clock, seed + k) for clock in left for k in range(LANES)]
        records = evaluate_lanes([policy], lanes, steps)
        made += int(records.end_step.sum())
        earned = records.returns[:, -1].reshape(len(left), LANES).mean(axis=1) / steps
        scores.update(zip(left, earned.tolist(), strict=True))
        keep = sorted(range(len(left)), key=lambda k: -earned[k])[: (len(left) + 1) // 2]
        left = [left[k] for k in sorted(keep)]
        steps, seed = min(2 * steps, most_steps), seed + LANES
    return RuleChoice("bandit", left[0], scores, made)
