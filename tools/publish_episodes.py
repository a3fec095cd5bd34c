"""Write the published episodes again into a folder; ten to fifteen minutes on one core."""

from __future__ import annotations

import sys
from collections import Counter
from importlib.metadata import version
from pathlib import Path

from perdure.home.tasks.episodes import EpisodeSet, write_episodes
from perdure.home.tasks.generation import generate_episodes
from perdure.home.tasks.tasks import TASKS

PUBLISHED = ("val", "eval", "eval-2")
"""The splits that are published; training draws its own."""


def publish(folder: Path, seed: int = 0) -> dict[str, Counter[str]]:
    """Write the published episodes of every task into a folder.

    Args:
        folder: Where to write them; made when missing.
        seed: Another seed gives other episodes; the published ones are those of seed 0.

    Returns:
        How often a draw was thrown away, by file and reason.
    """
    folder.mkdir(parents=True, exist_ok=True)
    refusals: dict[str, Counter[str]] = {}
    for task in TASKS:
        for split in PUBLISHED:
            refused = list[str]()
            made = generate_episodes(task, split, seed, refused.append)
            made_with = {"seed": str(seed), "mujoco": version("mujoco")}
            write_episodes(folder / f"{task}_{split}.json", EpisodeSet(task, split, made_with, made.episodes))
            thrown = refusals[f"{task}_{split}"] = Counter(refused)
            print(f"{task}_{split}: {len(made)} episodes, thrown away: {dict(thrown) or 'none'}", flush=True)
    return refusals


if __name__ == "__main__":
    publish(Path(sys.argv[1]))
