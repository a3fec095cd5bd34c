"""What epsilon and the speed of the inverse-kinematics hand-over change: SetTable, shipped policies, drag.

python benchmarks/hand_over.py [episodes]

Each pair places the same episodes with the same policies (training seed 0). Epsilon 0 stops and goes nowhere.
"""

from __future__ import annotations

import sys
from collections import Counter

import numpy as np

from perdure.home.agents.release import Ik
from perdure.home.agents.release.ik import EPSILON, SPEED
from perdure.home.benchmark.episodes import load_episodes
from perdure.home.evaluate.execute import Executor, ExecutorOptions
from perdure.home.evaluate.outcomes import analyze
from perdure.home.evaluate.protocol import Protocol, choose_policies, make_actors
from perdure.home.sim.world import SceneOptions

TASK, ROLLING = "set_table", "drag"
PAIRS = (
    *((epsilon, SPEED) for epsilon in (0.0, 0.02, EPSILON, 0.1, 0.2)),
    *((EPSILON, speed) for speed in (0.05, 0.3, 0.6)),
)


def row(epsilon: float, speed: float, count: int) -> str:
    """One row of the table, in Markdown."""
    actors = make_actors(choose_policies(TASK, 0), "rl")
    arm = actors["place"] = Ik(actors["place"], epsilon=epsilon, speed=speed)
    options = ExecutorOptions(scene=SceneOptions(rolling=ROLLING))
    executor = Executor(Protocol(TASK).skills(), actors, options, strategy="ik", train_seed=0)
    analysis = analyze(list(executor.run(load_episodes(TASK, "val").episodes[:count])))
    placed = analysis.placements
    ways = Counter(arm.outcomes)
    cells = (
        f"{epsilon:.2f} m",
        f"{speed:.2f} m/s",
        f"{int((~placed['stabilizing']).sum())} of {len(placed)}",
        f"{100 * float(np.median(placed['release_height'])):.1f} cm",
        f"{float(np.median(placed['object_speed'])):.3f} m/s",
        f"{ways['out of reach']}, {ways['blocked']}",
    )
    return "| " + " | ".join(cells) + " |"


def main(count: int) -> None:
    """Prints the table."""
    print("| epsilon | speed | did not stay | height at the release | speed at the release | out of reach, blocked |")
    print("|---|---|---|---|---|---|")
    for epsilon, speed in PAIRS:
        print(row(epsilon, speed, count), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
