"""Days written by hand: rows of the table, and errands that a script carries out without a simulator."""

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "outcomes"))

from home_stories import Story

ROW = {
    "errands": "tidy_house",
    "split": "eval",
    "place": "rl",
    "world": "",
    "planner": "closed",
    "fallback": "none",
    "disturbance": "none",
    "home": 0,
    "train_seed": 0,
    "eval_seed": 0,
    "task": "tidy_house",
    "stays": True,
    "upright": True,
    "undisturbed": True,
    "soft": True,
    "targets": 5,
    "taken_over": 0,
    "fell": 0,
    "tipped_targets": 0,
    "knocked_over": 0,
    "stood": 2.0,
    "on_floor": 0,
    "tipped": 0,
    "out_of_reach": 0,
    "doors_open": 0,
    "then": "goes on",
}
"""An errand as it should be."""


def make_day(count=8, changes=None, last="the time is up", hours=0.1, **everywhere):
    """Rows of the day of a home: `changes` by number of the errand."""
    rows = []
    for number in range(1, count + 1):
        row = {**ROW, **everywhere, "errand": number, "begin": hours * (number - 1), "end": hours * number}
        rows.append({**row, **(changes or {}).get(number, {})})
    rows[-1]["then"] = last
    return rows


def scripted_errands(change):
    """Return a stand-in of `Executor.run_to_end`, which does every errand well but for what `change` does.

    `change` gets (errand, poses of its objects) and may move them.
    """

    def run_to_end(executor, errands, observe=None):
        for errand in errands:
            log = Story(errand.task, episode=errand).rest(range(len(errand.goals))).log(settle=10)
            poses = np.array([[*each.position, *each.quaternion] for each in errand.objects])
            poses[: len(errand.goals), :3] = errand.goal_positions
            change(errand, poses)
            scene = SimpleNamespace(links=tuple(errand.positions), placements=errand.objects)
            yield (
                log,
                SimpleNamespace(
                    scene=scene,
                    links=np.array(list(errand.positions.values())),
                    held=-1,
                    robot=np.arange(30.0),
                    objects=lambda count, poses=poses: (poses, None),
                ),
            )

    return run_to_end
