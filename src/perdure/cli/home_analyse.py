"""``perdure home analyse``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from perdure.cli.parse import parse


@dataclass(frozen=True)
class HomeAnalyse:
    """Say what became of executed episodes: success per stage, failure modes, placements by kind of object."""

    logs: tyro.conf.Positional[tuple[Path, ...]]
    """Files of logs, or folders that hold some."""


def main(args: list[str]) -> None:
    """``perdure home analyse``."""
    flags = parse(HomeAnalyse, args, "home analyse")
    from perdure.home.errors import HomeError
    from perdure.home.outcomes import analyse, read_logs

    paths = [path for given in flags.logs for path in (sorted(given.rglob("*.parquet")) if given.is_dir() else [given])]
    if not paths:
        raise HomeError(f"there are no logs (*.parquet) in {', '.join(map(str, flags.logs)) or 'nothing'}")
    print(analyse([record for path in paths for record in read_logs(path)]).summary())
