"""Cost of an evaluation and of its report as the number of lanes grows: time of a lane-step, peak memory.

python benchmarks/scale.py evaluate [LANES ...]   Swimmer-v3, 300 steps (more for fewer than 100 lanes), one core
python benchmarks/scale.py report [LANES ...]     a synthetic table: 145 rows for each lane, as 100,000 steps give

Each row is measured in a separate process. Times are CPU times. The time of a lane-step leaves out the
start: the same evaluation with one lane and one step. Memory is the largest sum of resident memory over the process and
its workers, looked at every 20 ms; shared pages count in each process.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

STEPS, LEAST = 300, 30_000
"""Steps of a lane; lane-steps of a measurement at least."""
LANES = {"evaluate": (10, 100, 1000, 10_000), "report": (105, 1050, 10_500)}
POLICIES, CLOCKS = 5, 21
"""Of the synthetic table: with 100 start states 10,500 lanes and 1.5 million rows."""


def evaluate(lanes: int, folder: Path) -> dict[str, float]:
    """Return the microseconds of a lane-step of a policy with random weights."""
    from perdure.extrapolate import Extrapolation, extrapolate

    policy = random_policy(folder)

    def seconds(steps: int, eval_seeds: int) -> float:
        began = processor_seconds()
        evaluation = Extrapolation((policy,), steps, eval_seeds=eval_seeds)
        assert len(extrapolate(evaluation, folder / "out", cores=1).final()) == eval_seeds
        return processor_seconds() - began

    steps = max(STEPS, LEAST // lanes)
    seconds(2, 1)  # measures the idle robot
    return {"us per lane-step": 1e6 * (-seconds(1, 1) + seconds(steps, lanes)) / (lanes * steps)}


def processor_seconds() -> float:
    """Return the time of the processor that this process and its ended workers took."""
    return time.process_time() + sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])


def random_policy(folder: Path) -> Path:
    """Write a policy for Swimmer-v3 with a time-to-go input."""
    from perdure.envs import make_world
    from perdure.horizon import Constant, Fixed, HorizonProtocol, Linear
    from perdure.policy import Normalizer, Policy, TaskInfo, measure_reference, save_policy

    world = make_world("Swimmer-v3", [0])
    spec = world.spec
    world.close()
    rng, size, weights = np.random.default_rng(0), spec.observation_size, {}
    for k, (rows, columns) in enumerate(pairwise((size + 1, 64, 64, spec.action_size))):
        weights[f"policy.{k}.weight"] = rng.normal(size=(rows, columns)).astype(np.float32) / rows**0.5
        weights[f"policy.{k}.bias"] = np.zeros(columns, np.float32)
    task = TaskInfo(spec.name, size, tuple(spec.action_low), tuple(spec.action_high))
    protocol = HorizonProtocol(Linear(), Fixed(1000), "terminated", 1.0, 0.99)
    normalizer = Normalizer(np.zeros(size), np.ones(size))
    policy = Policy(task, weights, "tanh", normalizer, protocol, Constant(500.0), {"method": "linear", "seed": 0})
    return save_policy(replace(policy, reference=measure_reference(policy, 20)), folder / "policy.safetensors")


def report(lanes: int, folder: Path) -> dict[str, float]:
    """Return the seconds that the report of a table takes."""
    subprocess.run([sys.executable, __file__, "--table", str(lanes), str(folder)], check=True)
    from perdure.report import estimate_table, read_lanes, write_report

    began = processor_seconds()
    write_report(estimate_table(read_lanes(folder / "lanes.parquet")[0]), folder / "report", "scale.py")
    return {"seconds": processor_seconds() - began}


def write_synthetic(lanes: int, folder: Path) -> None:
    """Write a table of POLICIES training runs of one method under CLOCKS constant clocks; half of the lanes fall."""
    import polars as pl

    from perdure.extrapolate.recorded_steps import recorded_steps
    from perdure.report import COLUMNS, write_table

    rng, lane, last = np.random.default_rng(0), np.arange(lanes), 100_000
    steps, seeds = recorded_steps(last), lanes // (POLICIES * CLOCKS)
    policy, clock = lane // (CLOCKS * seeds), lane // seeds % CLOCKS
    ends = np.where(rng.random(lanes) < 0.5, last, np.ceil(rng.exponential(0.3 * last, lanes)).clip(1, last - 1))
    facts = {
        **{"method": "geometric", "task": "Hopper-v3", "clock_kind": "constant", "policy_state": "worked"},
        **{"train_horizon": 1000.0, "test_horizon": last, "idle_rate": 0.9, "reference_rate": 2.5, "level_rate": 3.1},
        **{"window": 50, "policy_note": "within its training horizon it earns 2.5 a step, an idle robot 0.9"},
    }
    each = {
        **{"policy": [f"geometric-{k}" for k in policy], "train_seed": policy, "eval_seed": lane % seeds},
        **{"clock": [f"constant({50 * k})" for k in clock], "clock_steps": 50.0 * clock},
        **{"end_step": ends, "failed_step": ends, "end_hold": rng.random(lanes), "ever_idle": rng.random(lanes) < 0.1},
        **{"end_reason": np.where(ends < last, "terminated", "survived")},
        **{"outcome": np.where(ends < last, "falls", "holds")},
        **{"end_detail": [f"observation[{k % 11}] left its training range at step {k}" for k in lane]},
        **{"movement_first": rng.random(lanes), "movement_last": rng.random(lanes)},
    }
    made = np.minimum(steps, ends[:, None])
    rate = rng.normal(2.5, 0.3, (lanes, 1))
    frame = pl.DataFrame(each)[np.repeat(lane, len(steps))].with_columns(
        pl.Series("step", np.tile(steps, lanes)),
        pl.Series("return", (rate * made).ravel()),
        pl.Series("alive", ((steps < ends[:, None]) | (ends[:, None] == last)).ravel()),
        **{name: pl.lit(value) for name, value in facts.items()},
    )
    write_table(folder / "lanes.parquet", frame.select(pl.col(name).cast(kind) for name, kind in COLUMNS.items()), {})


MEASUREMENTS: dict[str, Callable[[int, Path], dict[str, float]]] = {"evaluate": evaluate, "report": report}


def measured(name: str, lanes: int) -> dict[str, float]:
    """Run one measurement in a separate process and add its peak memory."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, __file__, "--measure", name, str(lanes)]
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    peak = [0]

    def watch() -> None:
        while process.poll() is None:
            peak[0] = max(peak[0], tree_memory(process.pid))
            time.sleep(0.02)

    watcher = threading.Thread(target=watch)
    watcher.start()
    output, _ = process.communicate()
    watcher.join()
    if process.returncode:
        sys.exit(f"{' '.join(command)} failed")
    found: dict[str, float] = json.loads(output.splitlines()[-1])
    return {**found, "peak MB": peak[0] / 1e6}


def tree_memory(pid: int) -> int:
    """Return the resident memory of a process and its workers, in bytes; what makes the table does not count."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        making = b"--table" in Path(f"/proc/{pid}/cmdline").read_bytes()
    except (OSError, IndexError):
        return 0
    return (not making) * pages * os.sysconf("SC_PAGESIZE") + sum(tree_memory(int(child)) for child in children)


def main(words: list[str]) -> Any:
    if words[0] == "--table":
        return write_synthetic(int(words[1]), Path(words[2]))
    if words[0] == "--measure":
        with tempfile.TemporaryDirectory() as folder:
            return print(json.dumps(MEASUREMENTS[words[1]](int(words[2]), Path(folder))))
    for number, lanes in enumerate(map(int, words[1:] or LANES[words[0]])):
        row = measured(words[0], lanes)
        if not number:
            print("| lanes |", *(f"{name} |" for name in row))
            print("|---|" + "---|" * len(row))
        print(f"| {lanes:,} |", *(f"{value:,.1f} |" for value in row.values()), flush=True)
    return None


if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in (*MEASUREMENTS, "--measure", "--table"):
        sys.exit(__doc__)
    main(sys.argv[1:])
