"""Print the power of the replication's claims: how often each would be decided as it says.

    python tools/replication_power.py

The training runs of the horizon study, drawn with replacement, stand for fresh ones. There are three to ten of them, so
the power is itself uncertain.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from perdure.studies.comparison import compare_unpaired
from perdure.studies.horizon.claim import Condition
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
            [list(results.values(task, side, claim.measure).values()) for side in (claim.left, claim.right)]
            for task in claim.tasks
        ]
        decided = 0
        for _ in range(DRAWS):
            drawn = [[rng.choice(side, len(FRESH)).tolist() for side in task] for task in seen]
            pooled = mean_over_tasks(claim, [compare_unpaired(left, right) for left, right in drawn])
            if pooled is not None and by_interval(claim, pooled, claim.margin) == "supported":
                decided += pooled.p(threshold(claim, pooled, claim.margin)) <= LEVEL
        print(f"{decided / DRAWS:.2f}  {claim.id}")


if __name__ == "__main__":
    main()
