"""What the first training runs suggest, as claims about fresh training runs.

The study's three to ten training runs left most claims undecided, but some differences are large. Testing them on the
runs that suggested them would flatter them. The scale `replication` trains 20 runs of three methods with other training
seeds and deploys them from other start states. C is not chosen: it is 500, the default.

Registered on 2026-11-25, before any of these runs was trained. A row is evaluated when all of its runs are there, so
nobody can stop at a convenient number.
"""

from __future__ import annotations

from perdure.studies.horizon.claim import Claim, Condition
from perdure.studies.horizon.claims import PPO, WALKERS

AVERAGE = Condition("ppo-average-reward")
CONSTANT = Condition("geometric", "constant:500")
SEEN = "first training runs of the horizon study"

REPLICATION_CLAIMS: tuple[Claim, ...] = (
    Claim(
        "average-reward-fails-less-often-than-discounted-ppo",
        SEEN,
        "PPO on the average reward fails in fewer episodes of 100,000 steps than discounted PPO.",
        tasks=WALKERS,
        left=AVERAGE,
        right=PPO,
        direction="less",
        measure="failed share",
    ),
    Claim(
        "average-reward-earns-more-than-discounted-ppo",
        SEEN,
        "PPO on the average reward earns more over 100,000 steps than discounted PPO.",
        tasks=WALKERS,
        left=AVERAGE,
        right=PPO,
        direction="greater",
    ),
    Claim(
        "average-reward-costs-little-within-the-horizon",
        SEEN,
        "Within the training horizon PPO on the average reward earns at least nine tenths of discounted PPO's return.",
        tasks=WALKERS,
        left=AVERAGE,
        right=PPO,
        direction="not less",
        measure="return within",
        margin=0.1,
    ),
    Claim(
        "a-constant-time-to-go-fails-less-often-than-discounted-ppo",
        SEEN,
        "Under a constant 500 steps to go the method fails in fewer episodes of 100,000 steps than discounted PPO.",
        tasks=WALKERS,
        left=CONSTANT,
        right=PPO,
        direction="less",
        measure="failed share",
    ),
    Claim(
        "average-reward-fails-less-often-than-a-constant-time-to-go",
        SEEN,
        "PPO on the average reward fails in fewer episodes of 100,000 steps than the method under a constant 500 steps "
        "to go.",
        tasks=WALKERS,
        left=AVERAGE,
        right=CONSTANT,
        direction="less",
        measure="failed share",
    ),
    Claim(
        "a-constant-fails-less-often-than-a-countdown",
        SEEN,
        "The method fails in fewer episodes under a constant 500 steps to go than under a countdown from 100,000.",
        tasks=WALKERS,
        left=CONSTANT,
        right=Condition("geometric", "countdown"),
        direction="less",
        measure="failed share",
    ),
)
