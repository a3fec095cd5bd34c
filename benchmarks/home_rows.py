"""Runs every row of the home results, the most important first; killed, it goes on where it stopped.

python benchmarks/home_rows.py HOME_RUNS [TASK ...]
python benchmarks/home_rows.py --list

Each row is a `perdure home run` command, which `--list` prints; TASK: only rows of these tasks. `python
benchmarks/home_protocol.py HOME_RUNS` then makes the tables, the pictures and the README's numbers of the logs.
"""

from __future__ import annotations

import os
import shlex
import sys
import time
from pathlib import Path

from perdure.cli.home.run import HomeRun, make_protocol
from perdure.cli.parse import parse
from perdure.home.evaluate.protocol import run_protocol

TASKS = ("set_table", "tidy_house", "prepare_groceries")
DRAG = "--rolling drag"
WORLDS = ("", f"{DRAG} --apple hull", f"{DRAG} --release-velocity base-removed")
"""Other worlds than the drag alone: friction, and what else is known to differ from Habitat."""
NINE, THREE = "--train-seeds 3 --eval-seeds 3", "--train-seeds 3"


def rows() -> list[str]:
    """Arguments of `perdure home run`, in the order in which they are run."""
    unseen = [f"{task} --place {how} {DRAG} --split eval {NINE}" for task in TASKS for how in ("rl", "stop", "ik")]
    worlds = [
        f"set_table --place {how} {world} --split eval {THREE}" for world in WORLDS for how in ("rl", "stop", "ik")
    ]
    worlds.append(f"set_table --place rl {DRAG} --release-velocity zero --split eval {THREE}")
    worlds += [f"{task} --place {how} --split eval {THREE}" for task in TASKS[1:] for how in ("rl", "stop", "ik")]
    known = [f"{task} --place {how} {DRAG} {THREE}" for task in TASKS for how in ("rl", "ik")]
    jaws = [f"tidy_house --place {how} {DRAG} --jaws apart --split eval {THREE}" for how in ("rl", "ik")]
    deltas = [f"{task} --place delta-200 {DRAG} --split eval {THREE}" for task in TASKS]
    deltas += [
        f"set_table --place {each} {DRAG} --split eval {THREE}" for each in ("delta-10", "delta-50", "delta-50-in-200")
    ]
    plus = [f"{task} --place ik+ {DRAG} --split eval {THREE}" for task in TASKS]
    return [" ".join(row.split()) for row in (*unseen, *worlds, *known, *jaws, *deltas, *plus)]


def main(out: Path, tasks: list[str]) -> None:
    """Runs what is missing; a line for each row."""
    cores = len(os.sched_getaffinity(0))
    wanted = [row for row in rows() if row.split()[0] in (tasks or TASKS)]
    for number, row in enumerate(wanted, 1):
        began, arguments = time.monotonic(), shlex.split(row)
        command = shlex.join(["perdure", "home", "run", *arguments])
        run_protocol(
            make_protocol(parse(HomeRun, arguments, "home run")), out, command=command, on="local", cores=cores
        )
        print(f"{number}/{len(wanted)}  {time.monotonic() - began:6.0f} s  {command}", flush=True)


if __name__ == "__main__":
    if "--list" in sys.argv:
        print("\n".join(f"perdure home run {row}" for row in rows()))
    elif len(sys.argv) >= 2 and set(sys.argv[2:]) <= set(TASKS):
        main(Path(sys.argv[1]), sys.argv[2:])
    else:
        sys.exit(__doc__)
