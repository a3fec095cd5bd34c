"""Measure the effect of descent and speed of the hand-over by inverse kinematics: SetTable, drag only.

Each row places the same episodes with the same policies (training seed 0). A descent of 0 stops without lowering.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import polars as pl

from perdure.home.agents.release import Ik
from perdure.home.agents.release.ik import EPSILON, SPEED
from perdure.home.benchmark.episodes import load_episodes
from perdure.home.evaluate.execute import Executor, ExecutorOptions
from perdure.home.evaluate.outcomes import analyze
from perdure.home.evaluate.protocol import EvaluationProtocol, choose_policies, make_agents
from perdure.home.sim.world import SceneOptions
from perdure.runs import Unit, Work
from perdure.studies.placement.grid import Grid
from perdure.studies.placement.row_step import EPISODE_COST
from perdure.studies.placement.unit_steps import TASK, Measurement, leave

VERSION = 1
"""Increase it when `measure` gives other numbers."""
PAIRS = (
    *((descent, SPEED) for descent in (0.0, 0.02, EPSILON, 0.1, 0.2)),
    *((EPSILON, speed) for speed in (0.05, 0.3, 0.6)),
)
"""Descent [m], speed [m/s]."""
SCHEMA: dict[str, type[pl.DataType]] = {
    "descent": pl.Float64,
    "speed": pl.Float64,
    "placements": pl.Int64,
    "not_stable": pl.Int64,
    "release_height": pl.Float64,
    "object_speed": pl.Float64,
    "out_of_reach": pl.Int64,
    "blocked": pl.Int64,
}
"""Of the table: [m], [m/s], counts, median height [m] and object speed [m/s] at release, counts of outcomes."""


def hand_over_step(grid: Grid, out: Path) -> Measurement:
    """Return the step that measures every pair."""
    units = tuple(_unit(descent, speed, grid.hand_over_episodes) for descent, speed in PAIRS)
    return Measurement("hand-over", units, EPISODE_COST[TASK], out, SCHEMA)


def _unit(descent: float, speed: float, episodes: int) -> Unit:
    arguments = {"descent": descent, "speed": speed, "episodes": episodes}
    config = {"version": VERSION, "measurement": "hand-over", **arguments}
    key = f"hand-over/descent-{descent:.2f}-speed-{speed:.2f}"
    return Unit(key, config, f"{__name__}:measure", arguments, size=float(episodes))


def measure(work: Work, *, descent: float, speed: float, episodes: int) -> None:
    """Write one row of the table; the function of the units."""
    agents = make_agents(choose_policies(TASK, 0), "rl")
    ik = agents["place"] = Ik(agents["place"], epsilon=descent, speed=speed)
    options = ExecutorOptions(scene=SceneOptions(rolling="drag"), threads=work.threads)
    executor = Executor(EvaluationProtocol(TASK).skills(), agents, options, strategy="ik", train_seed=0)
    logs = []
    for log in executor.run(load_episodes(TASK, "val").episodes[:episodes]):
        logs.append(log)
        work.report(len(logs), episodes)
    placed, ways = analyze(logs).placements, Counter(ik.outcomes)
    values = (
        descent,
        speed,
        len(placed),
        int((~placed["stabilizing"]).sum()),
        round(float(np.median(placed["release_height"].to_numpy())), 3),
        round(float(np.median(placed["object_speed"].to_numpy())), 3),
        ways["out of reach"],
        ways["blocked"],
    )
    leave(work, dict(zip(SCHEMA, values, strict=True)))
