"""One group of lanes in a process of its own (`perdure.processes.serve`).

A process for each core, each with single-threaded arithmetic, so that results do not depend on how many there are.
EnvPool's thread and ours hand over at every step: on one core they take turns, on two they wait for each other.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from perdure.extrapolate.evaluate import evaluate_lanes
from perdure.extrapolate.lanes import LaneSpec
from perdure.extrapolate.table import lane_table
from perdure.horizon import clock_from_json
from perdure.policy import load_policy
from perdure.processes import serve
from perdure.store import Store

TABLE = "lanes.parquet"


def work(job: dict[str, Any], tell: Callable[[Any], None]) -> None:
    """Evaluates the lanes of a job and leaves its unit in the store; tells (step, living lanes) now and then."""
    lanes = [
        LaneSpec(policy, None if clock is None else clock_from_json(clock), seed)
        for policy, clock, seed in job["lanes"]
    ]
    policies = [load_policy(path) for path in job["policies"]]
    records = evaluate_lanes(policies, lanes, job["steps"], lambda step, living: tell([step, living]))
    frame = lane_table(job["labels"], policies, lanes, records, job["steps"])
    with Store(job["store"]).write(job["key"], job["config"]) as folder:
        frame.write_parquet(folder / TABLE)


if __name__ == "__main__":
    serve(work)
