"""Makes the tables, the picture and the README's numbers of the home results from logs.

python benchmarks/home_protocol.py HOME_RUNS

HOME_RUNS is the folder of `python benchmarks/home_rows.py HOME_RUNS`. Writes benchmarks/home_protocol.json, the tables
of docs/home/results.md, the table in README.md and docs/images/home-arms.png. Rows of which HOME_RUNS has no logs stay
as they are in benchmarks/home_protocol.json: delete that file after a change of the world or of the policies.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from marks import put

from perdure.home.benchmark.tasks import TASKS
from perdure.home.evaluate.outcomes import COUNTINGS, analyse, paired_difference
from perdure.home.evaluate.outcomes.differences import SAME_PLACEMENT
from perdure.home.evaluate.page import Cast, read_cast
from perdure.home.evaluate.page.comparison import Comparison, comparisons
from perdure.home.evaluate.protocol.naming import read_arm
from perdure.home.sim.objects import KINDS
from perdure.report.charts import Axis, Chart, Series
from perdure.report.palette import category
from perdure.report.png_renderer import render_png
from perdure.store import write_whole

RESULTS = Path(__file__).parent / "home_protocol.json"
DOCS = Path(__file__).parents[1] / "docs"
PAGE = DOCS / "home" / "results.md"
README = Path(__file__).parents[1] / "README.md"
PICTURE = DOCS / "images" / "home-arms.png"
Row = dict[str, Any]

GROUPS = {"sphere": "apples", "bowl": "bowls", "cylinder": "cans", "box": "boxes", "rounded_box": "boxes"}
"""How the tables call objects of a shape."""
STRATEGIES = ("rl", "delta-10", "delta-50", "delta-50-in-200", "delta-200", "stop", "ik", "ik+")
"""In the order of the tables."""
WORLDS = {
    "drag": "no rolling resistance",
    "drag hull-apple": "the same, apple a convex hull",
    "drag base-velocity-removed": "the same, base velocity removed at release",
    "drag released-at-zero-velocity": "the same, all velocity removed at release",
    "": "rolling friction",
    "jaws-apart drag": "no rolling resistance, `--jaws apart`",
}
"""What a name of `arm_name` adds to the strategy, and how the tables call that world."""
TITLES = {"set_table": "SetTable", "tidy_house": "TidyHouse", "prepare_groceries": "PrepareGroceries"}
BOUNDS = ("estimate", "lower", "upper")
PAIRS = (("rl", "stop"), ("rl", "ik"), ("stop", "ik"), ("ik", "ik+"), ("rl", "delta-200"))
SHOWN = ("rl", "stop", "ik")
THESIS = {"rl": 0.418, "ik": 0.653}
"""Success in SetTable on the validation set (thesis, section 2.3)."""


def numbers(comparison: Comparison, arm: str, cast: Cast) -> Row:
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
            f"{row['stage']}, {row['mechanism']}": row["count"]
            for row in comparison.modes[arm].filter(counting="stabilizing").iter_rows(named=True)
        },
        "hand_overs": dict(cast.hand_overs.get((comparison.task, comparison.split, arm), {})),
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
            if not set(names) <= set(comparison.arms):
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


def percent(share: float, digits: int = 1) -> str:
    """0.917 -> "91.7"."""
    return f"{100 * share:.{digits}f}"


def share(success: Row) -> str:
    """Return the mean and its 95 % interval."""
    return f"{percent(success['mean'])} % [{percent(success['lower'], 0)}, {percent(success['upper'], 0)}]"


def by_seed(success: Row) -> str:
    """Return the success of each training seed."""
    return ", ".join(percent(each, 0) for each in success["train_seeds"])


def size(row: Row) -> str:
    """Training seeds x evaluation seeds x episodes."""
    train, evaluated = row["seeds"]["train"], row["seeds"]["eval"]
    return f"{train} x {evaluated} x {row['episodes'] // (train * evaluated)}"


def lost(row: Row) -> str:
    """Return how many placements of each group of objects did not stay."""
    counts: dict[str, tuple[int, int]] = {}
    for name, kind in row["kinds"].items():
        group = GROUPS[KINDS[name].shape]
        bad, of = counts.get(group, (0, 0))
        counts[group] = bad + kind["not_stable"], of + kind["placements"]
    return ", ".join(f"{group} {bad:,} of {of:,}" for group, (bad, of) in sorted(counts.items()))


def strategy_and_world(row: Row) -> tuple[str, str]:
    """Return the two parts of a row's name: `ik drag hull-apple` -> ("ik", "drag hull-apple")."""
    strategy = read_arm(row["arm"])[0]
    return strategy, row["arm"].removeprefix(strategy).strip()


def chosen(rows: list[Row], split: str, world: str | None = None, task: str | None = None) -> list[Row]:
    """Return rows of a split, perhaps of one world and task, by task, world and strategy."""
    found = []
    for row in rows:
        strategy, where = strategy_and_world(row)
        if row["split"] == split and world in (None, where) and task in (None, row["task"]) and where in WORLDS:
            found.append((list(TITLES).index(row["task"]), list(WORLDS).index(where), STRATEGIES.index(strategy), row))
    return [row for *_, row in sorted(found, key=lambda each: each[:3])]


def markdown(headings: tuple[str, ...], lines: list[tuple[str, ...]]) -> str:
    """Return a table in Markdown."""
    rule = "|" + "---|" * len(headings)
    return "\n".join([f"| {' | '.join(headings)} |", rule, *(f"| {' | '.join(line)} |" for line in lines)])


def headline(rows: list[Row], differences: list[Row]) -> str:
    """Success on unseen layouts without rolling resistance."""
    headings = ("task", "strategy", "seeds x episodes", "goal-stabilizing", "by training seed", "latched")
    headings += ("placements that did not stay",)
    lines = []
    for row in chosen(rows, "eval", "drag"):
        cells = (TITLES[row["task"]], f"`{strategy_and_world(row)[0]}`", size(row), share(row["stabilizing"]))
        lines.append((*cells, by_seed(row["stabilizing"]), share(row["latched"]), lost(row)))
    return markdown(headings, lines)


def difference_table(rows: list[Row], differences: list[Row]) -> str:
    """Paired differences, worlds below each other."""
    lines = []
    for each in differences:
        if each["split"] == "eval" and (each["world"] == "drag" or each["second"] != "ik+"):
            bounds = [
                f"{percent(part['estimate'])} [{percent(part['lower'])}, {percent(part['upper'])}]"
                for part in (each, each["placements"])
            ]
            pair = f"`{each['second']}` - `{each['first']}`"
            lines.append((TITLES[each["task"]], WORLDS[each["world"]], pair, *bounds))
    return markdown(
        ("task", "world", "difference", "episodes that succeed [points]", "placements that stay [points]"), lines
    )


def world_table(rows: list[Row], differences: list[Row]) -> str:
    """Every world; SetTable in all of them, the other tasks with rolling friction."""
    lines = []
    for row in chosen(rows, "eval"):
        strategy, world = strategy_and_world(row)
        if strategy in SHOWN and world != "jaws-apart drag":
            cells = (TITLES[row["task"]], WORLDS[world], f"`{strategy}`", size(row), share(row["stabilizing"]))
            lines.append((*cells, by_seed(row["stabilizing"]), lost(row)))
    headings = ("task", "world", "strategy", "seeds x episodes", "goal-stabilizing", "by training seed")
    return markdown((*headings, "placements that did not stay"), lines)


def jaws_table(rows: list[Row], differences: list[Row]) -> str:
    """TidyHouse when an object that was let go can meet the gripper's jaws again."""
    lines = []
    for row in chosen(rows, "eval", task="tidy_house"):
        strategy, world = strategy_and_world(row)
        if strategy in ("rl", "ik") and world in ("drag", "jaws-apart drag"):
            lines.append((WORLDS[world], f"`{strategy}`", size(row), share(row["stabilizing"]), lost(row)))
    headings = ("world", "strategy", "seeds x episodes", "goal-stabilizing", "placements that did not stay")
    return markdown(headings, lines)


def layout_table(rows: list[Row], differences: list[Row]) -> str:
    """Known and unseen layouts side by side."""
    lines = []
    unseen = {(row["task"], row["arm"]): row for row in chosen(rows, "eval", "drag")}
    for row in chosen(rows, "val", "drag"):
        other = unseen.get((row["task"], row["arm"]))
        if other is not None:
            cells = (TITLES[row["task"]], f"`{strategy_and_world(row)[0]}`")
            cells += (f"{share(row['latched'])} ({size(row)})", f"{share(other['latched'])} ({size(other)})")
            drop = other["latched"]["mean"] - row["latched"]["mean"]
            lines.append((*cells, f"{100 * drop:+.1f} points"))
    return markdown(("task", "strategy", "val (known layouts)", "eval (unseen layout)", "change"), lines)


def thesis_table(rows: list[Row], differences: list[Row]) -> str:
    """SetTable, val, latched: the thesis' own count, and the episodes that failed at a placement."""
    lines = []
    for row in chosen(rows, "val", "drag", "set_table"):
        strategy, _ = strategy_and_world(row)
        if strategy not in THESIS:
            continue
        unstable = sum(row["failed_at"].values()) / row["episodes"]
        lines.append(
            (
                f"`{strategy}`",
                f"{percent(THESIS[strategy])} %",
                f"{share(row['latched'])} ({size(row)})",
                {"rl": "45.4 %", "ik": "18.0 %"}[strategy],
                f"{percent(unstable)} %",
            )
        )
    headings = ("strategy", "success, thesis", "success, ours", "failed at a placement, thesis")
    return markdown((*headings, "failed at a placement, ours"), lines)


def mode_table(rows: list[Row], differences: list[Row]) -> str:
    """What fails with the hand-over, in few groups."""
    groups: dict[str, tuple[str, tuple[str, ...]]] = {
        "pick: not reached": ("pick", ("not reached", "time-out")),
        "pick: grasp missed or wrong object": ("pick", ("grasp missed", "wrong object grasped")),
        "pick: collision": ("pick", ("collision",)),
        "place: tipped": ("place", ("tipped",)),
        "place: rolled": ("place", ("rolled",)),
        "place: thrown or dropped": ("place", ("thrown", "dropped")),
        "place: other": ("place", ("not reached", "time-out", "collision", "displaced by the robot")),
    }
    lines = []
    for row in chosen(rows, "eval", "drag"):
        if (strategy := strategy_and_world(row)[0]) not in SHOWN:
            continue
        left, counts = dict(row["modes"]), []
        for stage, mechanisms in groups.values():
            names = [n for n in left if n.startswith(stage) and n.split(", ")[1] in mechanisms]
            counts.append(sum(left.pop(name) for name in names))
        failed = sum(counts) + sum(left.values())
        cells = (TITLES[row["task"]], f"`{strategy}`", f"{failed} of {row['episodes']}")
        lines.append((*cells, *map(str, counts), str(sum(left.values()))))
    return markdown(("task", "strategy", "failed", *groups, "doors and drawers, rest"), lines)


def hand_over_table(rows: list[Row], differences: list[Row]) -> str:
    """How often a release strategy fell back."""
    picked = [row for row in chosen(rows, "eval", "drag") if row["hand_overs"]]
    outcomes = sorted({outcome for row in picked for outcome in row["hand_overs"]})
    lines = []
    for row in picked:
        counts = (str(row["hand_overs"].get(outcome, 0)) for outcome in outcomes)
        lines.append((TITLES[row["task"]], f"`{strategy_and_world(row)[0]}`", *counts))
    return markdown(("task", "strategy", *outcomes), lines)


TABLES: dict[str, Callable[[list[Row], list[Row]], str]] = {
    "headline": headline,
    "differences": difference_table,
    "worlds": world_table,
    "jaws": jaws_table,
    "layouts": layout_table,
    "thesis": thesis_table,
    "modes": mode_table,
    "hand_overs": hand_over_table,
}
"""Mark in docs/home/results.md to the function that writes what stands there."""


def readme_table(rows: list[Row]) -> str:
    """The headline for the README: success of each task on unseen layouts."""
    lines = []
    for task, title in TITLES.items():
        found = {strategy_and_world(row)[0]: row for row in chosen(rows, "eval", "drag", task)}
        if set(SHOWN) <= found.keys():
            lines.append((title, *(share(found[strategy]["stabilizing"]) for strategy in SHOWN)))
    names = ("policy alone (`rl`)", "stop, then release (`stop`)", "stop, lower by 5 cm, release (`ik`)")
    return markdown(("task", *names), lines)


def picture(rows: list[Row]) -> Chart:
    """How often each strategy succeeds: tasks on unseen layouts, then SetTable in the other worlds."""
    places = [(task, "drag") for task in TITLES] + [
        ("set_table", world) for world in WORLDS if world not in ("drag", "jaws-apart drag")
    ]
    names = [TITLES[task] if world == "drag" else f"SetTable: {_short(world)}" for task, world in places]
    found = {(row["task"], *strategy_and_world(row)): row["stabilizing"] for row in chosen(rows, "eval")}
    strategies = {"rl": "policy alone", "stop": "stop, then release", "ik": "stop, lower 5 cm, release"}
    series = []
    for number, (strategy, label) in enumerate(strategies.items()):
        at = [k for k, (task, world) in enumerate(places) if (task, strategy, world) in found]
        rows_of = [found[places[k][0], strategy, places[k][1]] for k in at]
        mean, lower, upper = (np.array([each[key] for each in rows_of]) for key in ("mean", "lower", "upper"))
        offset = 0.24 * (number - 1)
        heights, color = np.array(at) + offset, category(number)
        series.append(Series(label, mean, heights, color, lower, upper, line=False, points=True))
        seeds = [(share, at[k] + offset + 0.08) for k, each in enumerate(rows_of) for share in each["train_seeds"]]
        x, y = np.array(seeds).T
        series.append(Series(f"{label}: one training seed", x, y, color, line=False, points=True, hollow=True))
    return Chart(
        "home-arms",
        "Does the object stay where it was put?",
        Axis("share of episodes whose objects all stay until the end", percent=True, low=0.0, high=1.0),
        Axis("", rows=tuple(names)),
        tuple(series),
        row_lines=4,
        note="Apartments with a layout never seen in training. Unless named otherwise the world has no rolling "
        "resistance. Bars: 95 % Student t interval over three training seeds (rings); three evaluation seeds of 100 "
        "episodes each for the tasks, one in the other worlds.",
    )


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
    records, cast = read_cast(sorted(folder.rglob("logs.parquet")))
    compared = comparisons(analyse(records))
    known: dict[str, list[Any]] = {"commands": [], "rows": [], "pairs": []}
    if RESULTS.exists():
        known = json.loads(RESULTS.read_text())
    new = {
        "rows": [numbers(each, arm, cast) for each in compared for arm in each.arms],
        "pairs": [pair for each in compared for pair in pairs(each)],
    }
    kept: dict[str, list[Any]] = {"commands": sorted({*known["commands"], *cast.commands})}
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
    write_whole(PICTURE, render_png(picture(kept["rows"])))


if __name__ == "__main__":
    if len(sys.argv) < 2 or set(TITLES) != set(TASKS):
        sys.exit(__doc__)
    main(Path(sys.argv[1]))
