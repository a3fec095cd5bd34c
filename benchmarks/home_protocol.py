"""Makes the tables, the picture and the README's numbers of the home results from logs.

python benchmarks/home_protocol.py HOME_RUNS

HOME_RUNS is the folder of `python benchmarks/home_rows.py HOME_RUNS`. Writes benchmarks/home_protocol.json, the tables
of docs/home/results.md, the table in README.md and docs/images/home-arms.png. Rows of which HOME_RUNS has no logs stay
as they are in benchmarks/home_protocol.json: delete that file after a change of the world or of the policies.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from home_tables import TABLES, TITLES, WORLDS, Row, chosen, readme_table, strategy_and_world
from marks import put

from perdure.home.benchmark.tasks import TASKS
from perdure.home.evaluate.outcomes import COUNTINGS, analyze, paired_difference
from perdure.home.evaluate.outcomes.differences import SAME_PLACEMENT
from perdure.home.evaluate.page import PolicyAssignment, read_assignment
from perdure.home.evaluate.page.comparison import Comparison, comparisons
from perdure.report.axes import Axis
from perdure.report.render import Figure, render
from perdure.report.rows import Points, point_chart
from perdure.report.theme import style
from perdure.runs import write_whole

RESULTS = Path(__file__).parent / "home_protocol.json"
DOCS = Path(__file__).parents[1] / "docs"
PAGE = DOCS / "home" / "results.md"
README = Path(__file__).parents[1] / "README.md"
PICTURE = DOCS / "images" / "home-arms.png"
BOUNDS = ("estimate", "lower", "upper")
PAIRS = (("rl", "stop"), ("rl", "ik"), ("stop", "ik"), ("ik", "ik+"), ("rl", "delta-200"))


def numbers(comparison: Comparison, arm: str, assignment: PolicyAssignment) -> Row:
    """Return one row: a task, a split, a release strategy in a world."""
    placed, episodes = comparison.placements[arm], comparison.episodes[arm]
    outcomes = {row["outcome"]: row["count"] for row in comparison.outcomes[arm].iter_rows(named=True)}
    finals = {counting: comparison.final(arm, counting) for counting in COUNTINGS}
    columns = {"latched": "success", "stabilizing": "stabilizing"}
    return {
        "task": comparison.task,
        "split": comparison.split,
        "arm": arm,
        "episodes": len(episodes),
        "seeds": {name: episodes[f"{name}_seed"].n_unique() for name in ("train", "eval")},
        **{
            counting: {
                **{key: round(float(final[key]), 4) for key in ("mean", "standard_error", "lower", "upper")},
                "method": final["method"],
                "train_seeds": [
                    round(share, 4)
                    for (share,) in episodes.group_by("train_seed")
                    .agg(pl.col(columns[counting]).mean())
                    .sort("train_seed")
                    .select(columns[counting])
                    .iter_rows()
                ],
            }
            for counting, final in finals.items()
        },
        "stages": {
            counting: {
                row["stage"]: round(row["mean"], 4)
                for row in comparison.stages[arm].filter(counting=counting).iter_rows(named=True)
            }
            for counting in COUNTINGS
        },
        "kinds": {
            row["kind"]: {
                "placements": row["placements"],
                "not_stable": row["failures"],
                "median_at_release": released(placed.filter(kind=row["kind"])),
            }
            for row in comparison.kinds[arm].iter_rows(named=True)
        },
        "failed": len(episodes) - int(episodes["success"].sum()),
        "failed_at": {name: count for name, count in outcomes.items() if name.startswith("place_")},
        "did_not_last": outcomes["success that did not last"],
        "modes": {
            f"{row['stage']}, {row['cause']}": row["count"]
            for row in comparison.modes[arm].filter(counting="stabilizing").iter_rows(named=True)
        },
        "hand_overs": dict(assignment.hand_overs.get((comparison.task, comparison.split, arm), {})),
    }


def released(placements: pl.DataFrame) -> dict[str, float]:
    """Return medians of how objects were released: height and offset in [m], speeds in [m/s], tilt in [deg]."""
    columns = ("release_height", "release_offset", "object_speed", "base_speed", "tilt")
    return {name: round(float(np.median(placements[name].to_numpy())), 3) for name in columns}


def pairs(comparison: Comparison) -> Iterator[Row]:
    """Yield the paired difference of every two strategies of `PAIRS` that ran in the same world."""
    for world in WORLDS:
        for first, second in PAIRS:
            names = [" ".join(filter(None, (strategy, world))) for strategy in (first, second)]
            if not set(names) <= set(comparison.strategies):
                continue
            left, right = (comparison.episodes[name] for name in names)
            found = paired_difference(left, right)
            placed = (comparison.placements[name] for name in names)
            stayed = paired_difference(*placed, keys=SAME_PLACEMENT)
            yield {
                "task": comparison.task,
                "split": comparison.split,
                "arm": f"{second} - {first}" + (f" {world}" if world else ""),
                "world": world,
                "first": first,
                "second": second,
                **{key: round(float(getattr(found, key)), 4) for key in BOUNDS},
                "placements": {key: round(float(getattr(stayed, key)), 4) for key in BOUNDS},
                "units": found.count,
                "method": found.method,
            }


def picture(rows: list[Row]) -> Figure:
    """How often each strategy succeeds: tasks on unseen layouts, then SetTable in the other worlds."""
    places = [(task, "drag") for task in TITLES] + [
        ("set_table", world) for world in WORLDS if world not in ("drag", "jaws-apart drag")
    ]
    names = [TITLES[task] if world == "drag" else f"SetTable, {_short(world)}" for task, world in places]
    found = {(row["task"], *strategy_and_world(row)): row["stabilizing"] for row in chosen(rows, "eval")}
    points = []
    for number, (strategy, label) in enumerate(STRATEGIES.items()):
        at = [k for k, (task, world) in enumerate(places) if (task, strategy, world) in found]
        rows_of = [found[places[k][0], strategy, places[k][1]] for k in at]
        mean, lower, upper = (np.array([each[key] for each in rows_of]) for key in ("mean", "lower", "upper"))
        seeds = [each["train_seeds"] for each in rows_of]
        points.append(Points(label, at, mean, style(number), lower, upper, seeds))
    return Figure(
        "home-arms",
        "Does the object stay where it was put?",
        point_chart(names, points, Axis("share of episodes whose objects all stay until the end", percent=True)),
        "Apartments with a layout never seen in training. Unless named otherwise the world has no rolling resistance. "
        "Filled: mean of n = 3 training seeds. Small open marks: each seed (n = 300 episodes in the first three rows, "
        "100 in the others). Bars: 95 % Student t intervals over the training seeds.",
    )


STRATEGIES = {"rl": "policy alone", "stop": "stop, then release", "ik": "stop, lower 5 cm, release"}


def _short(world: str) -> str:
    return {
        "drag hull-apple": "apple a convex hull",
        "drag base-velocity-removed": "base velocity removed",
        "drag released-at-zero-velocity": "released at zero velocity",
        "": "rolling friction",
    }[world]


def key(row: Row) -> tuple[str, str, str]:
    """What a row is about."""
    return row["task"], row["split"], row["arm"]


def main(folder: Path) -> None:
    """Summarize all logs of a folder."""
    records, assignment = read_assignment(sorted(folder.rglob("logs.parquet")))
    compared = comparisons(analyze(records))
    known: dict[str, list[Any]] = {"commands": [], "rows": [], "pairs": []}
    if RESULTS.exists():
        known = json.loads(RESULTS.read_text())
    new = {
        "rows": [numbers(each, arm, assignment) for each in compared for arm in each.strategies],
        "pairs": [pair for each in compared for pair in pairs(each)],
    }
    kept: dict[str, list[Any]] = {"commands": sorted({*known["commands"], *assignment.commands})}
    for name, found in new.items():
        merged = {**{key(row): row for row in known[name]}, **{key(row): row for row in found}}
        kept[name] = sorted(merged.values(), key=key)
    write_whole(RESULTS, json.dumps(kept, indent=1) + "\n")
    page = PAGE.read_text()
    for mark, table in TABLES.items():
        text = table(kept["rows"], kept["pairs"])
        page = put(page, mark, text)
        print(f"{mark}\n\n{text}\n")
    write_whole(PAGE, page)
    write_whole(README, put(README.read_text(), "home results", readme_table(kept["rows"])))
    write_whole(PICTURE, render(picture(kept["rows"])))


if __name__ == "__main__":
    if len(sys.argv) < 2 or set(TITLES) != set(TASKS):
        sys.exit(__doc__)
    main(Path(sys.argv[1]))
