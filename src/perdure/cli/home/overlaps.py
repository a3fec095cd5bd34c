"""``perdure home overlaps``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from perdure.cli.home.flags import log_files, parse_home


@dataclass(frozen=True)
class HomeOverlaps:
    """List pairs of objects at rest that overlap after the last step of logged episodes; exit code 1 if there are any.

    This checks the simulation: solid objects cannot lie inside each other. Depths are computed from the poses in the
    logs.
    """

    logs: tyro.conf.Positional[tuple[Path, ...]]
    """Log files, or folders that hold some."""
    deeper_than: float = 0.005
    """Depth in [m] up to which an overlap is not listed: contacts are slightly soft."""


def main(args: list[str]) -> None:
    """Run ``perdure home overlaps``."""
    flags = parse_home(HomeOverlaps, args, "overlaps")
    from perdure.home.evaluate.files import read_logs
    from perdure.home.evaluate.outcomes import find_overlaps

    episodes = unknown = found = 0
    for path in log_files(flags.logs):
        records = read_logs(path)
        episodes += len(records)
        unknown += sum(not record.final_objects for record in records)
        for overlap in find_overlaps(records, flags.deeper_than):
            found += 1
            print(overlap.line, flush=True)
    checked = f"{episodes - unknown:,} episodes checked" + (f", {unknown:,} have no final poses" if unknown else "")
    print(f"{checked}: {found} pairs at rest overlap by more than {1000 * flags.deeper_than:g} mm")
    if found:
        raise SystemExit(1)
