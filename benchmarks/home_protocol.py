"""What the home protocol came to, with the commands that ran it.

python benchmarks/home_protocol.py HOME_RUNS

HOME_RUNS is the `--out` of `perdure home run`. Writes benchmarks/home_protocol.json and prints the table of
docs/home/results.md: one row for each task, split and arm.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from perdure.home.outcomes import COUNTINGS, analyse
from perdure.home.page import read_cast
from perdure.home.page.comparison import Comparison, comparisons
from perdure.store import write_whole

RESULTS = Path(__file__).parent / "home_protocol.json"


def numbers(comparison: Comparison, arm: str) -> dict[str, Any]:
    """One row."""
    placed = comparison.placements[arm]
    outcomes = {row["outcome"]: row for row in comparison.outcomes[arm].iter_rows(named=True)}
    unstable = [outcomes[name] for name in outcomes if name.startswith("place_")]
    finals = {counting: comparison.final(arm, counting) for counting in COUNTINGS}
    keys = ("mean", "standard_error", "lower", "upper")
    return {
        "task": comparison.task,
        "split": comparison.split,
        "arm": arm,
        "episodes": len(comparison.episodes[arm]),
        "runs": finals["latched"]["runs"],
        **{counting: {key: round(float(row[key]), 4) for key in keys} for counting, row in finals.items()},
        "stages": {
            counting: {
                row["stage"]: round(row["mean"], 4)
                for row in comparison.stages[arm].filter(counting=counting).iter_rows(named=True)
            }
            for counting in COUNTINGS
        },
        "placements": len(placed),
        "in_goal_at_release_then_not": int((placed["in_goal_release"] & ~placed["stabilizing"]).sum()),
        "not_stable": int((~placed["stabilizing"]).sum()),
        "kinds": {
            row["kind"]: {
                "placements": row["placements"],
                "not_stable": row["failures"],
                "median_at_release": released(placed.filter(kind=row["kind"])),
            }
            for row in comparison.kinds[arm].iter_rows(named=True)
        },
        "failed_at_a_placement": sum(row["count"] for row in unstable),
        "failed": len(comparison.episodes[arm]) - int(comparison.episodes[arm]["success"].sum()),
        "modes": {
            f"{row['stage']}, {row['mechanism']}": row["count"]
            for row in comparison.modes[arm].filter(counting="stabilizing").iter_rows(named=True)
        },
    }


def released(placements: pl.DataFrame) -> dict[str, float]:
    """Medians of how objects were let go: height and offset in [m], speeds in [m/s], tilt in [deg]."""
    columns = ("release_height", "release_offset", "object_speed", "base_speed", "tilt")
    return {name: round(float(np.median(placements[name].to_numpy())), 3) for name in columns}


def share(success: dict[str, float]) -> str:
    """Mean and 95 % interval."""
    return f"{100 * success['mean']:.1f} % [{100 * success['lower']:.1f}, {100 * success['upper']:.1f}]"


def main(folder: Path) -> None:
    """Summarises all logs of a folder."""
    records, cast = read_cast(sorted(folder.rglob("logs.parquet")))
    rows = [numbers(each, arm) for each in comparisons(analyse(records)) for arm in each.arms]
    acting = {
        " ".join(group): {skill: list(names) for skill, names in who.items()} for group, who in cast.acting.items()
    }
    kept = {"commands": list(cast.commands), "acting": acting, "rows": rows}
    write_whole(RESULTS, json.dumps(kept, indent=1) + "\n")
    print("| task | split | arm | episodes | latched | goal-stabilizing | placements that did not stay |")
    print("|---|---|---|---|---|---|---|")
    for row in rows:
        shares = [share(row[counting]) for counting in COUNTINGS]
        unstable = f"{row['not_stable']} of {row['placements']}"
        cells = (row["task"], row["split"], row["arm"], row["episodes"], *shares, unstable)
        print("| " + " | ".join(map(str, cells)) + " |")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
