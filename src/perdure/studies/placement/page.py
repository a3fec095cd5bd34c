"""The page of the results: question, result in words, tables, figures, commands."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from perdure.report.render import Figure
from perdure.runs import write_atomic
from perdure.studies.placement.grid import Grid
from perdure.studies.placement.markdown import difference_table, headline, percent
from perdure.studies.placement.markdown_measured import hand_over_measured, noise_measured
from perdure.studies.placement.names import TITLES
from perdure.studies.placement.release_speed import speed_table
from perdure.studies.placement.results import Results, Row, chosen, strategy_and_world
from perdure.studies.placement.tables import Tables

QUESTION = "Do placed objects stay, and which release strategy and which world decide it?"


def write_page(path: Path, grid: Grid, tables: Tables, figures: Sequence[Figure]) -> Path:
    """Write the page; the same tables give the same bytes."""
    results = tables.results
    parts = [
        f"# Placement study\n\nWritten by `perdure study placement`. {QUESTION}\n",
        _earlier_rows(results.rows),
        _part("Result", result_text(results)),
        _part("Success on unseen layouts, drag only", headline(results.rows, results.pairs)),
        _part("Paired differences on unseen layouts", difference_table(results.rows, results.pairs)),
        _part("Descent and speed of `ik`", hand_over_measured(tables.hand_over)) if len(tables.hand_over) else "",
        _part("Halting under exploration noise", noise_measured(tables.noise)) if len(tables.noise) else "",
        _part("Placements that stay, by release speed", speed_table(tables.speeds)) if len(tables.speeds) else "",
        _part("Figures", "\n".join(map(_link, figures))) if figures else "",
        _commands(grid),
    ]
    return write_atomic(path, "\n".join(part for part in parts if part))


def _earlier_rows(rows: Sequence[Row]) -> str:
    """Return the note on rows that no logs of this study have replaced; "" if there are none."""
    count = sum(row.get("earlier_run", False) for row in rows)
    if not count:
        return ""
    return (
        f"{count} of {len(rows)} rows keep numbers of an earlier run, whose logs were not kept. Until they are run "
        "again, the tables of descent, noise and release speed are copies of published pages, rounded as there. "
        "`perdure study placement --scale thesis` replaces them.\n"
    )


def result_text(results: Results) -> str:
    """Return the result in words, or that rows are missing."""
    found = {
        (row["task"], strategy_and_world(row)[0]): row["stabilizing"]["mean"]
        for row in chosen(results.rows, "eval", "drag")
    }
    tasks = [task for task in TITLES if {(task, "rl"), (task, "stop")} <= found.keys()]
    pairs = [pair for pair in results.pairs if _compares(pair, "stop", "ik")]
    if not tasks or not pairs:
        return "The rows that answer the question are not all there yet."
    changes = ", ".join(
        f"from {percent(found[task, 'rl'])} % to {percent(found[task, 'stop'])} % in {TITLES[task]}" for task in tasks
    )
    text = f"With drag only, stopping before the release changes success {changes} (unseen layouts)."
    if friction := [pair for pair in results.pairs if _compares(pair, "rl", "stop", "")]:
        text += f" With rolling friction, the default, the difference is {_differences(friction)}."
    inside = sum(not (pair["lower"] > 0.0 or pair["upper"] < 0.0) for pair in pairs)
    units = "training seeds" if results.rows[0]["seeds"]["train"] > 1 else "episodes of one training seed"
    kinds = " or ".join(
        sorted({f"{pair['method']} intervals of paired differences over {pair['units']} {units}" for pair in pairs})
    )
    return (
        f"{text} Lowering the object by inverse kinematics after the stop is not distinguishable from stopping alone "
        f"in {inside} of {len(pairs)} tasks (drag only): {_differences(pairs)}. Brackets: 95 % {kinds}; wide ones "
        "exclude little."
    )


def _differences(pairs: Sequence[Row]) -> str:
    return ", ".join(
        f"{percent(pair['estimate'])} [{percent(pair['lower'])}, {percent(pair['upper'])}] points "
        f"in {TITLES[pair['task']]}"
        for pair in sorted(pairs, key=lambda pair: list(TITLES).index(pair["task"]))
    )


def _compares(pair: Row, first: str, second: str, world: str = "drag") -> bool:
    return (pair["first"], pair["second"], pair["world"], pair["split"]) == (first, second, world, "eval")


def _part(heading: str, text: str) -> str:
    return f"## {heading}\n\n{text}\n"


def _link(figure: Figure) -> str:
    title = ": ".join(filter(None, (figure.heading, figure.title)))
    return f"- [{title}](figures/{figure.name}.png) ({figure.note.split('. ')[0]})"


def _commands(grid: Grid) -> str:
    command = f"perdure study placement --scale {grid.name}"
    return (
        "## Commands\n\n"
        f"    {command}                   # runs what is missing, then writes all of it again\n"
        f"    {command} --analyze-only    # from logs and committed tables alone\n\n"
        "Logs are in `runs/`, which is too large to be committed. A row without logs keeps the numbers in "
        "`tables/strategies.json`.\n"
    )
