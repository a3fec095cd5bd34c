"""What the home protocol came to, with the commands that ran it.

python benchmarks/home_protocol.py HOME_RUNS

HOME_RUNS is the `--out` of `perdure home run`. Writes benchmarks/home_protocol.json, the tables of
docs/home/results.md (one for each task, one row for each world, split and arm) and docs/images/home-arms.png. Rows of
which HOME_RUNS has no logs stay as they are: after a change of the world or of the policies delete
benchmarks/home_protocol.json first.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from marks import put

from perdure.home.objects import KINDS
from perdure.home.outcomes import COUNTINGS, analyse
from perdure.home.page import read_cast
from perdure.home.page.comparison import Comparison, comparisons
from perdure.home.protocol import placing
from perdure.home.protocol.naming import read_arm
from perdure.home.tasks import TASKS
from perdure.report.charts import Axis, Chart, Series
from perdure.report.palette import category
from perdure.report.png_renderer import render_png
from perdure.store import write_whole

RESULTS = Path(__file__).parent / "home_protocol.json"
PAGE = Path(__file__).parents[1] / "docs" / "home" / "results.md"
PICTURE = Path(__file__).parents[1] / "docs" / "images" / "home-arms.png"
GROUPS = {"sphere": "apples", "bowl": "bowls", "cylinder": "cans", "box": "boxes", "rounded_box": "boxes"}
"""How the tables call objects of a shape."""
ARMS = ("rl", "delta-200", "stop", "ik", "ik+")
WORLDS = (("set_table", "drag"), ("tidy_house", "drag"), ("prepare_groceries", "drag"), ("set_table", "friction"))
"""What the picture shows, from top to bottom."""


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
        "seeds": {name: comparison.episodes[arm][f"{name}_seed"].n_unique() for name in ("train", "eval")},
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
        "modes_by_train_seed": modes_by_train_seed(comparison, arm),
        "kinds_by_train_seed": kinds_by_train_seed(placed),
    }


def modes_by_train_seed(comparison: Comparison, arm: str) -> dict[str, dict[str, int]]:
    """Goal-stabilizing failures of each training seed, to see whether they are one policy's."""
    failures = comparison.analysis.failures.filter(
        task=comparison.task, split=comparison.split, arm=arm, counting="stabilizing"
    )
    counts = failures.group_by("train_seed", "stage", "mechanism").len().sort("train_seed", "stage", "mechanism")
    found: dict[str, dict[str, int]] = {}
    for seed, stage, mechanism, count in counts.iter_rows():
        found.setdefault(str(seed), {})[f"{stage}, {mechanism}"] = count
    return found


def kinds_by_train_seed(placements: pl.DataFrame) -> dict[str, dict[str, dict[str, float]]]:
    """How many objects of each kind a training seed's policies lose, and the median speed in [m/s] at the release."""
    bad, speed = (~pl.col("stabilizing")).sum(), pl.col("object_speed").median()
    counts = placements.group_by("train_seed", "kind").agg(pl.len(), bad, speed).sort("train_seed", "kind")
    found: dict[str, dict[str, dict[str, float]]] = {}
    for seed, kind, count, not_stable, median in counts.iter_rows():
        row = {"placements": count, "not_stable": not_stable, "object_speed": round(median, 3)}
        found.setdefault(str(seed), {})[kind] = row
    return found


def released(placements: pl.DataFrame) -> dict[str, float]:
    """Medians of how objects were let go: height and offset in [m], speeds in [m/s], tilt in [deg]."""
    columns = ("release_height", "release_offset", "object_speed", "base_speed", "tilt")
    return {name: round(float(np.median(placements[name].to_numpy())), 3) for name in columns}


def share(success: dict[str, float]) -> str:
    """Mean and 95 % interval."""
    return f"{100 * success['mean']:.1f} % [{100 * success['lower']:.1f}, {100 * success['upper']:.1f}]"


def lost(row: dict[str, Any]) -> str:
    """How many placements of each group of objects did not stay."""
    counts: dict[str, tuple[int, int]] = {}
    for name, kind in row["kinds"].items():
        group = GROUPS[KINDS[name].shape]
        bad, of = counts.get(group, (0, 0))
        counts[group] = bad + kind["not_stable"], of + kind["placements"]
    return ", ".join(f"{group} {bad} of {of}" for group, (bad, of) in sorted(counts.items()))


def order(row: dict[str, Any]) -> tuple[bool, bool, int, int, str]:
    """Where a row stands in its table: by split, world, arm; policies that were trained for a Delta by that."""
    arm, options = read_arm(row["arm"])
    delta = placing(arm).delta
    rank = ARMS.index("delta-200" if delta > 1 else arm)
    return row["split"] != "val", options.scene.rolling == "drag", rank, delta, row["arm"]


def table(rows: list[dict[str, Any]]) -> str:
    """One task's table, in Markdown."""
    lines = [
        "| world | arm | seeds x episodes | latched | goal-stabilizing | placements that did not stay |",
        "|---|---|---|---|---|---|",
    ]
    for row in sorted(rows, key=order):
        arm, options = read_arm(row["arm"])
        world = options.scene.rolling + ("" if row["split"] == "val" else f", {row['split']} split")
        jaws = "" if options.jaws == "never" else f", `--jaws {options.jaws}`"
        train, evaluated = row["seeds"]["train"], row["seeds"]["eval"]
        times = f"{train} x {evaluated} x {row['episodes'] // (train * evaluated)}"
        cells = (world, f"`{arm}`{jaws}", times, *(share(row[counting]) for counting in COUNTINGS), lost(row))
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)


def picture(rows: list[dict[str, Any]]) -> Chart:
    """How often each arm comes to a goal-stabilizing success, task by task."""
    found = {}
    for row in rows:
        arm, options = read_arm(row["arm"])
        if row["split"] == "val" and options.jaws == "never":
            found[row["task"], options.scene.rolling, arm] = row["stabilizing"]
    series = []
    for number, arm in enumerate(ARMS):
        at = [place for place, world in enumerate(WORLDS) if (*world, arm) in found]
        numbers = [found[*WORLDS[place], arm] for place in at]
        mean, lower, upper = (np.array([each[key] for each in numbers]) for key in ("mean", "lower", "upper"))
        places = np.array(at) + 0.15 * (number - (len(ARMS) - 1) / 2)
        series.append(
            Series(arm, mean, places, category(number), lower, upper, line=False, points=True, hollow=arm == "rl")
        )
    return Chart(
        "home-arms",
        "Does the object stay where it was put?",
        Axis("share of episodes whose objects all stay (goal-stabilizing)", percent=True, low=0.0, high=1.0),
        Axis("", rows=tuple(f"{task}, {rolling}" for task, rolling in WORLDS)),
        tuple(series),
        row_lines=len(ARMS),
        note="Learned policies, val split. drag: nothing but a slow drag stops an object that rolls, as in Habitat; "
        "friction: rolling friction. rl: the policy alone; delta-200: trained until objects stay for 200 steps; "
        "stop: halts before it lets go; ik, ik+: the inverse-kinematics hand-over. Bars: from the lowest to the "
        "highest of three training seeds.",
    )


def key(row: dict[str, Any]) -> tuple[str, str, str]:
    """What a row is about."""
    return row["task"], row["split"], row["arm"]


def main(folder: Path) -> None:
    """Summarises all logs of a folder."""
    records, cast = read_cast(sorted(folder.rglob("logs.parquet")))
    rows = [numbers(each, arm) for each in comparisons(analyse(records)) for arm in each.arms]
    acting = {
        " ".join(group): {skill: list(names) for skill, names in who.items()} for group, who in cast.acting.items()
    }
    known = json.loads(RESULTS.read_text()) if RESULTS.exists() else {"commands": [], "acting": {}, "rows": []}
    rows = sorted([*{**{key(row): row for row in known["rows"]}, **{key(row): row for row in rows}}.values()], key=key)
    commands = sorted({*known["commands"], *cast.commands})
    kept = {"commands": commands, "acting": dict(sorted({**known["acting"], **acting}.items())), "rows": rows}
    write_whole(RESULTS, json.dumps(kept, indent=1) + "\n")
    page = PAGE.read_text()
    for task in TASKS:
        text = table([row for row in rows if row["task"] == task])
        page = put(page, task, text)
        print(f"{task}\n\n{text}\n")
    write_whole(PAGE, page)
    write_whole(PICTURE, render_png(picture(rows)))


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    main(Path(sys.argv[1]))
