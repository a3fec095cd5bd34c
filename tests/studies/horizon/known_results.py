"""Results of known answer: evaluations with the returns that a test says."""

import math
from itertools import product

import polars as pl

from perdure.report.schema import COLUMNS
from studies.horizon.grid import ZOO, Grid, Row, Split
from studies.horizon.results import CLOCKS, EPISODES, LEARNING, MECHANISMS, freeze_episodes, select

STEPS = (10, 900, 1000)
HORIZON = STEPS[-1]
SPLITS = (Split("validation", 1000, 1), Split("test", 2000, 2))


def episodes(method, clock, seed, eval_seed, total, *, falls=False, published_rate=3.0, task="Hopper-v3"):
    """The rows of one episode that earns `total` evenly, or falls after step 10 and earns it until then."""
    kind, _, number = clock.partition(":")
    steps = math.nan if kind == "none" else float(number or HORIZON)
    name = "none" if kind == "none" else f"{kind}({steps:.0f})"
    end = 10 if falls else HORIZON
    common = {
        "policy": method,
        "method": method,
        "task": task,
        "train_seed": seed,
        "train_horizon": 100.0,
        "clock": name,
        "clock_kind": kind,
        "clock_steps": steps,
        "eval_seed": eval_seed,
        "test_horizon": HORIZON,
        "end_reason": "terminated" if falls else "survived",
        "end_step": end,
        "end_detail": "observation[1] left its training range at step 9" if falls else "",
        "movement_first": 1.0,
        "movement_last": math.nan if falls else 1.0,
        **dict.fromkeys(("goal_first_step", "goal_longest_stay", "goal_at_end"), math.nan),
        "idle_rate": 0.0,
        "training_rate": 1.5,
        "published_rate": published_rate,
        "window": 10,
        "policy_state": "worked",
        "policy_note": "",
        "outcome": "falls" if falls else "holds",
        "failed_step": end,
        "end_score_vs_training": math.nan if falls else 1.0,
        "ever_idle": False,
    }
    return [
        {**common, "step": step, "return": total * min(step, end) / end, "alive": step < end or not falls}
        for step in STEPS
    ]


def table(*parts, **changes):
    """An evaluation of these episodes, with some columns changed."""
    return pl.DataFrame([{**row, **changes} for part in parts for row in part], schema=COLUMNS)


def make_results(test, validation=None, task="Hopper-v3", tasks=(), **changes):
    """Return results with these evaluations, and nothing else.

    Args:
        test: {(method, clock): {seed: return}}; a return of None is a fall that earns 1.
        validation: Likewise; the test ones by default.
        task: Of all of them.
        tasks: With the same returns on each, in place of `task`.
        changes: Columns that have another value in every episode.
    """
    methods = dict.fromkeys(method for method, _ in test)
    seeds = {method: sorted({s for (m, _), runs in test.items() if m == method for s in runs}) for method in methods}
    rows = tuple(Row(each, method, ZOO, tuple(seeds[method]), 1) for each in tasks or (task,) for method in methods)
    grid = Grid("thesis", rows, SPLITS, HORIZON, ("sweep",))
    frozen = []
    for split, row in product(SPLITS, rows):
        runs = test if split.name == "test" or validation is None else validation
        parts = [
            episodes(
                row.method, clock, seed, split.first_seed + k, 1.0 if value is None else value, falls=value is None
            )
            for (method, clock), values in runs.items()
            if method == row.method
            for seed, value in values.items()
            for k in range(split.seeds)
        ]
        if parts:
            frozen.append(freeze_episodes(table(*parts, **changes), row.setting, row.method, split.name))
    others = (pl.DataFrame(schema=each.columns) for each in (LEARNING, MECHANISMS, CLOCKS))
    return select(grid, pl.concat(frozen or [pl.DataFrame(schema=EPISODES.columns)]), *others)
