"""The tables of the study in Markdown, from the committed tables alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from perdure.home.sim.objects import KINDS
from perdure.studies.placement.names import GROUPS, TITLES, WORLDS
from perdure.studies.placement.results import Row, chosen, strategy_and_world

SHOWN = ("rl", "stop", "ik")
THESIS = {"rl": 0.418, "ik": 0.653}
"""Success in SetTable on the validation set (thesis, section 2.3)."""


def percent(share: float, digits: int = 1) -> str:
    """Return a share in percent: 0.917 -> "91.7"."""
    return f"{100 * share:.{digits}f}"


def share(success: Row) -> str:
    """Return the mean and its 95 % interval."""
    return f"{percent(success['mean'])} % [{percent(success['lower'], 0)}, {percent(success['upper'], 0)}]"


def by_seed(success: Row) -> str:
    """Return the success of each training seed."""
    return ", ".join(percent(each, 0) for each in success["train_seeds"])


def size(row: Row) -> str:
    """Return training seeds x evaluation seeds x episodes."""
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


def markdown(headings: tuple[str, ...], lines: Sequence[tuple[str, ...]]) -> str:
    """Return a table in Markdown."""
    rule = "|" + "---|" * len(headings)
    return "\n".join([f"| {' | '.join(headings)} |", rule, *(f"| {' | '.join(line)} |" for line in lines)])


def headline(rows: Sequence[Row], differences: Sequence[Row]) -> str:
    """Return success on unseen layouts, drag only."""
    headings = ("task", "strategy", "seeds x episodes", "goal-stabilizing", "by training seed", "latched")
    lines = []
    for row in chosen(rows, "eval", "drag"):
        cells = (TITLES[row["task"]], f"`{strategy_and_world(row)[0]}`", size(row), share(row["stabilizing"]))
        lines.append((*cells, by_seed(row["stabilizing"]), share(row["latched"]), lost(row)))
    return markdown((*headings, "placements that did not stay"), lines)


def difference_table(rows: Sequence[Row], differences: Sequence[Row]) -> str:
    """Return paired differences in every world."""
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


def world_table(rows: Sequence[Row], differences: Sequence[Row]) -> str:
    """Return every world: SetTable in all of them, the other tasks with rolling friction."""
    lines = []
    for row in chosen(rows, "eval"):
        strategy, world = strategy_and_world(row)
        if strategy in SHOWN and world != "jaws-apart drag":
            cells = (TITLES[row["task"]], WORLDS[world], f"`{strategy}`", size(row), share(row["stabilizing"]))
            lines.append((*cells, by_seed(row["stabilizing"]), lost(row)))
    headings = ("task", "world", "strategy", "seeds x episodes", "goal-stabilizing", "by training seed")
    return markdown((*headings, "placements that did not stay"), lines)


def jaws_table(rows: Sequence[Row], differences: Sequence[Row]) -> str:
    """Return TidyHouse when a released object can meet the gripper's jaws again."""
    lines = []
    for row in chosen(rows, "eval", task="tidy_house"):
        strategy, world = strategy_and_world(row)
        if strategy in ("rl", "ik") and world in ("drag", "jaws-apart drag"):
            lines.append((WORLDS[world], f"`{strategy}`", size(row), share(row["stabilizing"]), lost(row)))
    headings = ("world", "strategy", "seeds x episodes", "goal-stabilizing", "placements that did not stay")
    return markdown(headings, lines)


def layout_table(rows: Sequence[Row], differences: Sequence[Row]) -> str:
    """Return known and unseen layouts side by side."""
    lines = []
    unseen = {(row["task"], row["strategy"]): row for row in chosen(rows, "eval", "drag")}
    for row in chosen(rows, "val", "drag"):
        other = unseen.get((row["task"], row["strategy"]))
        if other is not None:
            cells = (f"{share(row['latched'])} ({size(row)})", f"{share(other['latched'])} ({size(other)})")
            drop = other["latched"]["mean"] - row["latched"]["mean"]
            lines.append((TITLES[row["task"]], f"`{strategy_and_world(row)[0]}`", *cells, f"{100 * drop:+.1f} points"))
    return markdown(("task", "strategy", "val (known layouts)", "eval (unseen layout)", "change"), lines)


def thesis_table(rows: Sequence[Row], differences: Sequence[Row]) -> str:
    """Return SetTable on known layouts beside the thesis: latched success, episodes that failed at a placement."""
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


def mode_table(rows: Sequence[Row], differences: Sequence[Row]) -> str:
    """Return the number of failures by stage and cause."""
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
        for stage, causes in groups.values():
            names = [n for n in left if n.startswith(stage) and n.split(", ")[1] in causes]
            counts.append(sum(left.pop(name) for name in names))
        failed = sum(counts) + sum(left.values())
        cells = (TITLES[row["task"]], f"`{strategy}`", f"{failed} of {row['episodes']}")
        lines.append((*cells, *map(str, counts), str(sum(left.values()))))
    return markdown(("task", "strategy", "failed", *groups, "doors and drawers, rest"), lines)


def hand_over_table(rows: Sequence[Row], differences: Sequence[Row]) -> str:
    """Return the outcomes of hand-overs by release strategy."""
    picked = [row for row in chosen(rows, "eval", "drag") if row["hand_overs"]]
    outcomes = sorted({outcome for row in picked for outcome in row["hand_overs"]})
    lines = []
    for row in picked:
        counts = (str(row["hand_overs"].get(outcome, 0)) for outcome in outcomes)
        lines.append((TITLES[row["task"]], f"`{strategy_and_world(row)[0]}`", *counts))
    return markdown(("task", "strategy", *outcomes), lines)


TABLES: dict[str, Callable[[Sequence[Row], Sequence[Row]], str]] = {
    "headline": headline,
    "differences": difference_table,
    "worlds": world_table,
    "jaws": jaws_table,
    "layouts": layout_table,
    "thesis": thesis_table,
    "modes": mode_table,
    "hand_overs": hand_over_table,
}
"""HTML comment mark in docs/home/results.md to the function that writes the table at that mark."""


def readme_table(rows: Sequence[Row]) -> str:
    """Return the headline for the README: success of each task on unseen layouts."""
    lines = []
    for task, title in TITLES.items():
        found = {strategy_and_world(row)[0]: row for row in chosen(rows, "eval", "drag", task)}
        if set(SHOWN) <= found.keys():
            lines.append((title, *(share(found[strategy]["stabilizing"]) for strategy in SHOWN)))
    names = ("policy alone (`rl`)", "stop, then release (`stop`)", "stop, lower by 5 cm, release (`ik`)")
    return markdown(("task", *names), lines)
