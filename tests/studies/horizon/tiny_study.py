"""A study that takes seconds: two methods on the inverted pendulum, with policies written by hand instead of trained.

As a program it is `python -m studies` whose scale "smoke" is this one:  python tiny_study.py horizon --out FOLDER
"""

import sys
from dataclasses import replace

import numpy as np
import polars as pl

from perdure.learn.presets import default_clock
from perdure.policy import Normalizer, Policy, TaskInfo, measure_reference, save_policy
from perdure.runs import Store
from studies.horizon import grid as grids
from studies.horizon.grid import Grid, Row, Split
from studies.horizon.study import POLICY, row_config, train_run

TASK = "InvertedPendulum-v4"
SCORED = (0.5, 6.0, 0.8, 1.2)
"""A linear controller that keeps the pole up (position, angle, and their velocities)."""
CLOCKS = ("constant:100", "constant:500", "periodic:500", "countdown")
GRID = Grid(
    "smoke",
    (Row(TASK, "ppo", "zoo", (0, 1), 1), Row(TASK, "geometric", "zoo", (0, 1), 1)),
    (Split("validation", 1000, 1), Split("test", 2000, 2)),
    400,
    CLOCKS,
    training_steps=2048,
)


def pendulum_policy(protocol, clock, *, seed=0, push=(), value=(), method="geometric"):
    """A policy that keeps the pole up, pushed aside by `push` times phi; its critic is `value` times phi."""
    noise = np.random.default_rng(seed).normal(scale=0.05, size=4)
    size = protocol.embedding_size
    actor, critic = np.zeros((4 + size, 1)), np.zeros((4 + size, 1))
    actor[:4, 0] = SCORED + noise
    actor[4 : 4 + len(push), 0] = push
    critic[4 : 4 + len(value), 0] = value
    weights = {"log_std": np.zeros(1), "policy.0.weight": actor, "policy.0.bias": np.zeros(1)}
    weights |= {"value.0.weight": critic, "value.0.bias": np.zeros(1)}
    return Policy(
        task=TaskInfo(TASK, 4, (-3.0,), (3.0,)),
        weights={name: array.astype(np.float32) for name, array in weights.items()},
        activation="tanh",
        normalizer=Normalizer(np.zeros(4), np.ones(4)),
        protocol=protocol,
        clock=clock,
        provenance={"method": method, "preset": "", "seed": seed},
        return_scale=1.0,
    )


def write_training(out, grid=GRID, push=(-10.0,)):
    """Put a finished training run for every row and seed into the store of a study."""
    store = Store(out / "runs")
    for row in grid.rows:
        run, config = train_run(grid, row), row_config(grid, row)
        for seed in row.seeds:
            unit = run.unit(seed)
            if store.done(unit.key, unit.config):
                continue
            timed = config.protocol.embedding is not None
            policy = pendulum_policy(
                config.protocol, default_clock(config), seed=seed, push=push if timed else (), method=row.method
            )
            policy = replace(policy, reference=measure_reference(policy, episodes=2))
            with store.workspace(unit.key, unit.config) as work:
                save_policy(policy, work.folder / POLICY)
                steps = np.linspace(100.0, 2048.0, 20)
                frame = pl.DataFrame({"step": steps, "return": steps / 10.0 + seed, "length": steps / 10.0})
                frame.write_parquet(work.folder / "episodes.parquet")


if __name__ == "__main__":
    from studies.__main__ import main

    grids.GRIDS["smoke"] = GRID
    main(sys.argv[1:])
