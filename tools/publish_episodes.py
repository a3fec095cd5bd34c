"""Write published episodes again: `python tools/publish_episodes.py FOLDER [TASK ...]`, all tasks when none is named.

A task takes three to five minutes on one core. Its episodes do not depend on the other tasks.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from perdure.home.tasks.episodes import PUBLISHED, EpisodeSet, episode_file, write_episodes
from perdure.home.tasks.generation import generate_episodes
from perdure.home.tasks.tasks import TASKS, get_task


def publish(folder: Path, tasks: Sequence[str] = tuple(TASKS), seed: int = 0) -> dict[str, Counter[str]]:
    """Write the published episodes of some tasks into a folder.

    Args:
        folder: Where to write them; made when missing. Files of other tasks stay as they are.
        tasks: Names of the tasks.
        seed: Another seed gives other episodes; the published ones are those of seed 0.

    Returns:
        How often a draw was rejected, by file and reason.

    Raises:
        PerdureError: If there is no such task.
    """
    for task in tasks:
        get_task(task)
    folder.mkdir(parents=True, exist_ok=True)
    refusals: dict[str, Counter[str]] = {}
    for task in tasks:
        for split in PUBLISHED:
            refused = list[str]()
            made = generate_episodes(task, split, seed, refused.append)
            made_with = {"seed": str(seed), "mujoco": version("mujoco")}
            write_episodes(folder / episode_file(task, split), EpisodeSet(task, split, made_with, made.episodes))
            reasons = Counter(refused)
            refusals[f"{task}_{split}"] = reasons
            print(f"{task}_{split}: {len(made)} episodes, rejected draws: {dict(reasons) or 'none'}", flush=True)
    return refusals


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("tasks", nargs="*", metavar="TASK")
    given = parser.parse_args()
    publish(given.folder, given.tasks or tuple(TASKS))
