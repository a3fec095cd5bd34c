"""Training episodes: generated once in the training apartments, then kept on disk."""

from __future__ import annotations

import hashlib
import os
import sys
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path

from perdure.home.benchmark.episodes import EpisodeSet, generate_episode, read_episodes, write_episodes
from perdure.home.benchmark.tasks import get_task
from perdure.home.errors import HomeError
from perdure.home.sim.apartments import split_apartments

POOL = 64
"""Episodes in a pool: one for each training apartment."""
_MADE_BY = ("sim/apartments", "sim/objects", "benchmark/tasks", "benchmark/episodes")
"""Folders whose code determines the episodes."""


def train_pool(task: str, count: int = POOL, seed: int = 0) -> EpisodeSet:
    """Return episodes of the split `train`, `count` of them spread over the apartments.

    The same arguments give the same episodes, and a larger pool begins with a smaller one. The first call needs about a
    second for each episode and reports progress on stderr; later calls read a file.

    Raises:
        HomeError: If `count` is not positive or the task is unknown.
    """
    get_task(task)
    if count < 1:
        raise HomeError(f"count must be 1 episode or more, not {count}")
    path = cache_folder() / f"{task}_train_{count}_seed{seed}_{fingerprint()}.json"
    if path.exists():
        try:
            return read_episodes(path)
        except HomeError as damage:
            print(f"{damage}; generating it again", file=sys.stderr)
    pool = _make(task, count, seed)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_episodes(path, pool)
    return pool


def cache_folder() -> Path:
    """Return the folder of the pools: `$XDG_CACHE_HOME/perdure/episodes`; `~/.cache` where the variable is not set."""
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "perdure" / "episodes"


@lru_cache(maxsize=1)
def fingerprint() -> str:
    """Return a digest (12 digits) of all that determines generated episodes: code and MuJoCo version."""
    digest = hashlib.sha256(version("mujoco").encode())
    home = Path(__file__).parents[2]
    for folder in _MADE_BY:
        for path in sorted((home / folder).rglob("*.py")):
            digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()[:12]


def _make(task: str, count: int, seed: int) -> EpisodeSet:
    from perdure.home.sim.objects import YcbObjects

    apartments, models = _spread(), YcbObjects()
    made = []
    for index in range(count):
        made.append(generate_episode(task, "train", index, apartments[index % len(apartments)], models, seed))
        message = f"making training episodes of {task}: {index + 1} of {count}"
        if sys.stderr.isatty():
            print(f"\r{message}", end="\n" if index + 1 == count else "", file=sys.stderr, flush=True)
        elif index + 1 in (1, count):
            print(message, file=sys.stderr, flush=True)
    return EpisodeSet(task, "train", {"seed": str(seed), "mujoco": version("mujoco")}, tuple(made))


def _spread() -> tuple[tuple[int, int], ...]:
    """Return the training apartments, all layouts among the first few."""
    return tuple(sorted(split_apartments("train"), key=lambda apartment: (apartment[1], apartment[0])))
