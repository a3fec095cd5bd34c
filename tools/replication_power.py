"""Print the power of the replication's claims: how often each would be decided as it says.

    python tools/replication_power.py

The training runs of the horizon study, drawn with replacement, stand for fresh ones. Their deviations from the mean are
widened by sqrt(n / (n - 1)), because n drawn runs spread less than the runs that they stand for. The first column takes
the differences seen for true, the second half of them: with three to ten runs they are uncertain, and what is picked
for being large tends to be smaller the next time.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from perdure.studies.comparison import FloatArray, compare_unpaired
from perdure.studies.horizon.claim import Claim, Condition
from perdure.studies.horizon.claims_replication import REPLICATION_CLAIMS
from perdure.studies.horizon.decide import by_interval, mean_over_tasks, threshold
from perdure.studies.horizon.grid import FRESH, GRIDS
from perdure.studies.horizon.results import read_results

RESULTS = Path(__file__).parents[1] / "results" / "horizon"
DRAWS = 1000
LEVEL = 0.05 / len(REPLICATION_CLAIMS)


def main() -> None:
    """Print one line for each claim."""
    results, rng = read_results(GRIDS["thesis"], RESULTS), np.random.default_rng(0)
    for claim in REPLICATION_CLAIMS:
        assert isinstance(claim.right, Condition)
        seen = [
            [np.array(list(results.values(task, side, claim.measure).values())) for side in (claim.left, claim.right)]
            for task in claim.tasks
        ]
        powers = (power(claim, seen, share, rng) for share in (1.0, 0.5))
        print(*(f"{each:.2f}" for each in powers), claim.id, sep="  ")


def power(claim: Claim, seen: list[list[FloatArray]], share: float, rng: np.random.Generator) -> float:
    """Return how often a claim is decided as it says.

    Args:
        claim: About the mean over its tasks.
        seen: For each task the runs of the left and of the right side.
        share: Of the difference seen that is taken for true.
        rng: Draws the runs.
    """
    decided = 0
    for _ in range(DRAWS):
        pooled = mean_over_tasks(claim, [compare_unpaired(*_draw(*sides, share, rng)) for sides in seen])
        if pooled is not None and by_interval(claim, pooled, claim.margin) == "supported":
            decided += pooled.p(threshold(claim, pooled, claim.margin)) <= LEVEL
    return decided / DRAWS


def _draw(left: FloatArray, right: FloatArray, share: float, rng: np.random.Generator) -> list[list[float]]:
    center = right.mean() + share * (left.mean() - right.mean())
    drawn = []
    for runs, mean in ((left, center), (right, right.mean())):
        deviations = (runs - runs.mean()) * math.sqrt(len(runs) / (len(runs) - 1))
        drawn.append((mean + rng.choice(deviations, len(FRESH))).tolist())
    return drawn


if __name__ == "__main__":
    main()
