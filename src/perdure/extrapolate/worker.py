"""One group of lanes in a process of its own: ``python -m perdure.extrapolate.worker JOB.json``.

A process for each core, each with single-threaded arithmetic, so that results do not depend on how many there are. It
prints "step living" now and then, and stops when its parent is gone.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

from perdure.extrapolate.evaluate import evaluate_lanes
from perdure.extrapolate.lanes import LaneSpec
from perdure.extrapolate.table import lane_table
from perdure.horizon import clock_from_json
from perdure.policy import load_policy
from perdure.store import Store

TABLE = "lanes.parquet"


def main() -> None:
    """Runs the job named on the command line and leaves its unit in the store."""
    job = json.loads(Path(sys.argv[1]).read_text())
    # EnvPool's thread and ours hand over at every step: on one core they take turns, on two they wait for each other.
    cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {cores[job["place"] % len(cores)]})
    lanes = [
        LaneSpec(policy, None if clock is None else clock_from_json(clock), seed)
        for policy, clock, seed in job["lanes"]
    ]
    policies = [load_policy(path) for path in job["policies"]]
    parent = os.getppid()

    def watch(step: int, living: int) -> None:
        if os.getppid() != parent:
            sys.exit("the process that asked for this evaluation is gone")
        print(step, living, flush=True)

    records = evaluate_lanes(policies, lanes, job["steps"], watch)
    frame = lane_table(job["labels"], policies, lanes, records, job["steps"])
    with Store(job["store"]).write(job["key"], job["config"]) as folder:
        frame.write_parquet(folder / TABLE)


if __name__ == "__main__":
    main()
