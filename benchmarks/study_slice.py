"""A slice of the horizon study, from nothing to the table of lanes: prints one JSON line.

python benchmarks/study_slice.py CONFIG.json

CONFIG.json is also what `benchmarks/peers/sb3.py study` reads: the same training runs, clocks, start states and steps.
"""

from __future__ import annotations

import dataclasses
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from perdure.envs import task_spec
from perdure.evaluate import Extrapolation, evaluate_files
from perdure.learn import TrainRun, method_config, train


def study(config: dict[str, Any], out: Path) -> float:
    """Return the seconds from the start of the training runs to the written table."""
    task, total = config["task"], config["total_steps"]
    settings = method_config("geometric", task, task_spec(task).observation_size, "zoo")
    settings = dataclasses.replace(settings, total_steps=total, segment_steps=total)
    began = time.perf_counter()
    run = TrainRun(task, "geometric", settings, tuple(config["seeds"]), preset="zoo")
    policies = tuple(train(run, out / "training", cores=config["cores"], on="local"))
    clocks, states = ("constant:500", "countdown"), config["start_states"]
    evaluation = Extrapolation(policies, config["test_steps"], clocks, states, disturb=("none",))
    result = evaluate_files(evaluation, out / "evaluation", cores=config["cores"])
    seconds = time.perf_counter() - began
    assert len(result.final()) == 2 * len(policies) * config["start_states"]
    return seconds


if __name__ == "__main__":
    values = json.loads(Path(sys.argv[1]).read_text())
    with tempfile.TemporaryDirectory() as folder:
        print(json.dumps({"seconds": study(values, Path(folder))}))
