"""What the first training runs suggest, as three claims about fresh training runs.

Testing a difference on the runs that suggested it would flatter it. The scale `replication` trains 20 runs of three
methods with other training seeds and deploys them from other start states. C is not chosen: it is 500, the default.

The measure is the gain over an idle robot. It has no threshold, pays nothing for standing still, and a slow robot
cannot hide behind its own slow training. Each claim is about the mean over three tasks, so Holm's method counts three
comparisons. `python tools/replication_power.py` prints their power at 20 runs. If the first runs (three to ten of each
method) show the true differences, it is about 0.9 for the two on the average reward and 0.3 for the one on the
time-to-go, which will probably stay undecided; if the true differences are half of those, it is 0.2 to 0.35 for all.

Registered on 2026-11-25, before any of these runs was trained. A row is evaluated when all of its lanes are there, so
nobody can stop at a convenient number. A training run that is interrupted resumes or is repeated with the same seed; a
run whose robot falls, diverges or never worked counts with what it gained.
"""

from __future__ import annotations

from perdure.studies.horizon.claim import Claim, Condition
from perdure.studies.horizon.claims import PPO

REPLICATED = ("Hopper-v3@cleanrl", "Walker2d-v3@cleanrl", "HalfCheetah-v3")
AVERAGE = Condition("ppo-average-reward")
CONSTANT = Condition("geometric", "constant:500")
SEEN = "first training runs of the horizon study"

REPLICATION_CLAIMS: tuple[Claim, ...] = (
    Claim(
        "average-reward-gains-more-than-discounted-ppo",
        SEEN,
        "PPO on the average reward gains more over an idle robot within 100,000 steps than discounted PPO, on average "
        "over the tasks.",
        tasks=REPLICATED,
        left=AVERAGE,
        right=PPO,
        direction="greater",
        measure="gain",
        over="mean",
    ),
    Claim(
        "average-reward-gains-more-than-a-constant-time-to-go",
        SEEN,
        "PPO on the average reward gains more over an idle robot within 100,000 steps than the method under a constant "
        "500 steps to go, on average over the tasks.",
        tasks=REPLICATED,
        left=AVERAGE,
        right=CONSTANT,
        direction="greater",
        measure="gain",
        over="mean",
    ),
    Claim(
        "a-constant-time-to-go-gains-as-much-as-discounted-ppo",
        "section 3.5",
        "Under a constant 500 steps to go the method matches or outperforms discounted PPO: within 100,000 steps its "
        "gain over an idle robot is lower by at most a tenth of a published policy's, on average over the tasks.",
        tasks=REPLICATED,
        left=CONSTANT,
        right=PPO,
        direction="not less",
        measure="gain",
        margin=0.1,
        over="mean",
    ),
)
