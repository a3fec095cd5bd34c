"""Write the published episodes again into a folder; ten to fifteen minutes on one core."""

from __future__ import annotations

import sys
from collections import Counter
from functools import partial
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
            thrown: Counter[str] = Counter()
            made = generate_episodes(task, split, seed, partial(_count, thrown))
            made_with = {"seed": str(seed), "mujoco": version("mujoco")}
            write_episodes(folder / f"{task}_{split}.json", EpisodeSet(task, split, made_with, made.episodes))
            refusals[f"{task}_{split}"] = thrown
            print(f"{task}_{split}: {len(made)} episodes, thrown away: {dict(thrown) or 'none'}", flush=True)
    return refusals


def _count(thrown: Counter[str], reason: str) -> None:
    thrown[reason] += 1


if __name__ == "__main__":
    publish(Path(sys.argv[1]))
