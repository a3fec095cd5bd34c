"""Episodes on disk: one JSON file per task and split, with a schema and a hash of its content.

A file that was damaged or edited is refused by its name.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

from perdure.home.benchmark.episodes.episode import Episode, EpisodeSet
from perdure.home.benchmark.episodes.schema import CONTENT, VERSION
from perdure.home.benchmark.tasks import get_task
from perdure.home.errors import HomeError
from perdure.home.sim.arrays import Quaternion, Vec3
from perdure.home.sim.objects import Placement
from perdure.runs import write_atomic
from perdure.schema import SchemaError, read_json

SCHEMA = "perdure.home.episodes"
DATA = Path(__file__).parent / "data"
"""Where the published episodes are."""


def load_episodes(task: str, split: str) -> EpisodeSet:
    """Return the published episodes of a task (`tidy_house`, ...) and a split (`val`, `eval`).

    Raises:
        HomeError: If there is no such task, or no episodes of that split are published.
    """
    get_task(task)
    published = sorted((p.stem.removeprefix(f"{task}_") for p in DATA.glob(f"{task}_*.json")), reverse=True)
    if split not in published:
        raise HomeError(f"split must be one of {', '.join(published)}, not {split!r}")
    return read_episodes(DATA / f"{task}_{split}.json")


def read_episodes(path: str | Path) -> EpisodeSet:
    """Return the episodes in a file.

    Raises:
        HomeError: With the file's name, when it is not one of episodes, damaged, edited or of another version.
    """
    path = Path(path)
    if not path.is_file():
        raise HomeError(
            f"{path} cannot be read as a file of episodes: it {'is no file' if path.exists() else 'is missing'}"
        )
    try:
        content = read_json(path.read_bytes())
    except (OSError, SchemaError) as error:
        raise HomeError(f"{path} cannot be read as a file of episodes: {error}") from error
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise HomeError(f"{path} is not a file of episodes: its schema is not {SCHEMA!r}")
    if content.get("version") != VERSION:
        raise HomeError(f"{path} has version {str(content.get('version'))[:20]}; this package reads version {VERSION}")
    if content.pop("sha256", None) != _digest(content):
        raise HomeError(f"{path} is damaged or was edited: its content does not match its sha256")
    try:
        CONTENT.check(content)
        return _from_json(content)
    except (SchemaError, HomeError) as error:
        raise HomeError(f"{path} does not hold what a file of episodes must hold: {error}") from error


def write_episodes(path: str | Path, episodes: EpisodeSet) -> None:
    """Write a file of episodes, whole or not at all."""
    content = _to_json(episodes)
    lines = ",\n".join(json.dumps(row, separators=(",", ":")) for row in content["episodes"])
    head = json.dumps({k: v for k, v in content.items() if k != "episodes"} | {"sha256": _digest(content)}, indent=1)
    write_atomic(path, f'{head[:-2]},\n "episodes": [\n{lines}\n]}}\n')


def _digest(content: dict[str, Any]) -> str:
    """Return the SHA-256 of the content; "" where it holds nan or is nested too deep, which no file of ours is."""
    try:
        text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    except (ValueError, RecursionError):
        return ""
    return hashlib.sha256(text.encode()).hexdigest()


def _to_json(episodes: EpisodeSet) -> dict[str, Any]:
    """Return JSON values: names once, and each object as [kind, x, y, z, qw, qx, qy, qz, receptacle]."""
    everything = [p for e in episodes.episodes for p in (*e.objects, *e.goals)]
    kinds = sorted({p.kind for p in everything})
    receptacles = sorted({p.receptacle for p in everything})

    def rows(placements: Sequence[Placement]) -> list[list[float]]:
        return [[kinds.index(p.kind), *p.position, *p.quaternion, receptacles.index(p.receptacle)] for p in placements]

    return {
        "schema": SCHEMA,
        "version": VERSION,
        "task": episodes.task,
        "split": episodes.split,
        "made_with": dict(episodes.made_with),
        "kinds": kinds,
        "receptacles": receptacles,
        "episodes": [
            {
                "index": e.index,
                "apartment": [e.macro, e.micro, e.apartment_fingerprint],
                "opened": dict(e.opened),
                "objects": rows(e.objects),
                "goals": rows(e.goals),
            }
            for e in episodes.episodes
        ],
    }


def _from_json(content: dict[str, Any]) -> EpisodeSet:
    kinds, receptacles = content["kinds"], content["receptacles"]

    def placements(rows: list[list[float]]) -> tuple[Placement, ...]:
        return tuple(
            Placement(
                kinds[int(row[0])],
                cast(Vec3, tuple(map(float, row[1:4]))),
                cast(Quaternion, tuple(map(float, row[4:8]))),
                receptacles[int(row[8])],
            )
            for row in rows
        )

    episodes = tuple(
        Episode(
            task=content["task"],
            split=content["split"],
            index=row["index"],
            macro=row["apartment"][0],
            micro=row["apartment"][1],
            apartment_fingerprint=row["apartment"][2],
            opened={str(link): float(q) for link, q in row["opened"].items()},
            objects=placements(row["objects"]),
            goals=placements(row["goals"]),
        )
        for row in content["episodes"]
    )
    return EpisodeSet(content["task"], content["split"], content["made_with"], episodes)
