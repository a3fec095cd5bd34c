"""Results of known answer: extrapolation tables with the returns that a test says, in the folders of a study."""

import math
from itertools import product

import polars as pl

from perdure.report import write_table
from perdure.report.schema import COLUMNS
from perdure.studies.horizon.grid import ZOO, Grid, Row, Split, evaluation_folder
from perdure.studies.horizon.results import read_results

STEPS = (10, 900, 1000)
HORIZON = STEPS[-1]
SPLITS = (Split("validation", 1000, 1), Split("test", 2000, 2))


def lanes(row, clock, seed, eval_seed, total, *, falls=False, level_rate=3.0):
    """The rows of one lane that earns `total` evenly, or falls after step 10 and earns it until then."""
    kind, _, number = clock.partition(":")
    steps = math.nan if kind == "none" else float(number or HORIZON)
    name = "none" if kind == "none" else f"{kind}({steps:.0f})"
    end = 10 if falls else HORIZON
    common = {
        "policy": row.method,
        "method": row.method,
        "task": row.task,
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
        "idle_rate": 0.0,
        "reference_rate": 1.5,
        "level_rate": level_rate,
        "window": 10,
        "policy_state": "worked",
        "policy_note": "",
        "outcome": "falls" if falls else "holds",
        "failed_step": end,
        "end_hold": math.nan if falls else 1.0,
        "ever_idle": False,
    }
    return [
        {**common, "step": step, "return": total * min(step, end) / end, "alive": step < end or not falls}
        for step in STEPS
    ]


def make_results(out, test, validation=None, task="Hopper-v3", confirmatory=False, tasks=()):
    """Write evaluations and read them back.

    Args:
        out: A folder.
        test: {(method, clock): {seed: return}}; a return of None is a fall that earns 1.
        validation: Likewise; the test ones by default.
        task: Of all of them.
        tasks: With the same returns on each, in place of `task`.
        confirmatory: Of the grid, which then has no validation start states.
    """
    methods = dict.fromkeys(method for method, _ in test)
    seeds = {method: sorted({s for (m, _), runs in test.items() if m == method for s in runs}) for method in methods}
    rows = tuple(Row(each, method, ZOO, tuple(seeds[method]), 1) for each in tasks or (task,) for method in methods)
    splits = SPLITS[1:] if confirmatory else SPLITS
    swept = tuple(clock for _, clock in test if clock != "none") if confirmatory else ("sweep",)
    grid = Grid("thesis", rows, splits, HORIZON, swept, confirmatory=confirmatory)
    for split, row in product(splits, rows):
        runs = test if split.name == "test" or validation is None else validation
        found = [
            part
            for (method, clock), values in runs.items()
            if method == row.method
            for seed, value in values.items()
            for k in range(split.seeds)
            for part in lanes(
                row, clock, seed, split.first_seed + k, 1.0 if value is None else value, falls=value is None
            )
        ]
        frame = pl.DataFrame(found, schema=COLUMNS)
        folder = evaluation_folder(out, split.name, row)
        folder.mkdir(parents=True)
        write_table(folder / "lanes.parquet", frame, {})
    return read_results(grid, out)
