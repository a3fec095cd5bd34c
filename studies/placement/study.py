"""The study of chapter 2: its units of work and its analysis."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from perdure.errors import PerdureError
from perdure.home.evaluate.analysis import analyze as analyze_logs
from perdure.home.evaluate.counts import counts_table
from perdure.home.evaluate.page import read_all
from perdure.home.evaluate.protocol import LOGS, episode_blocks, protocol_units
from perdure.report.charts import save
from perdure.runs import Store, Unit
from studies.files import include_tables
from studies.placement.figures import draw_figures
from studies.placement.grid import GRIDS, PHASES, Row, make_grid
from studies.placement.tables import PAGE_TABLES, Tables, read_tables, release_speeds, with_logs, write_tables

QUESTION = "Do placed objects stay, and which release strategy and which world decide it?"
SCALES = {"smoke": None, "laptop": None, "thesis": Path("results", "placement")}
"""Name of a scale to the folder of its results, if they are kept in the repository."""
__all__ = ["PHASES", "QUESTION", "SCALES", "analyze", "plan"]


def plan(scale: str, phases: Sequence[int], store: Path) -> list[Unit]:
    """Return the units of a scale: blocks of episodes of each row.

    Raises:
        PerdureError: The policies of a row are missing.
    """
    rows = make_grid(scale, phases)
    return [unit for row in rows for unit in protocol_units(row.protocol(), row.command, Store(store))]


def analyze(scale: str, out: Path) -> list[Path]:
    """Write tables and figures from what is there, of every phase, and the tables of the page `README.md`.

    Numbers of rows that are not finished stay.

    Raises:
        PerdureError: There are no results in the folder, or a table is damaged.
    """
    if not any((out / name).is_dir() for name in ("runs", "tables")):
        raise PerdureError(f"there are no results of the study placement in {out}; run it first, or name another --out")
    tables = update_tables(GRIDS[scale], out)
    written = write_tables(out / "tables", tables)
    written += save(draw_figures(tables), out / "figures", ("svg",))
    page = out / "README.md"
    shown = {name: make(tables) for name, make in PAGE_TABLES.items()} if page.is_file() else {}
    return [*written, include_tables(page, shown)] if shown else written


def finished_logs(row: Row, store: Path) -> list[Path]:
    """Return the logs of all blocks of a row; none while one is missing."""
    protocol = row.protocol()
    runs = Store(store)
    keys = [block.key for block in episode_blocks(protocol, runs)]
    return [runs.get(key) / LOGS for key in keys] if all(map(runs.done, keys)) else []


def update_tables(grid: Sequence[Row], out: Path) -> Tables:
    """Return the tables with the numbers of finished rows; all others keep theirs."""
    tables = read_tables(out / "tables")
    logs = {row: finished_logs(row, out / "runs") for row in grid}
    paths = sorted(path for paths in logs.values() for path in paths)
    if not paths:
        return tables
    records, notes = read_all(paths)
    analysis = analyze_logs(records)
    tables = with_logs(tables, analysis, notes.tables["hand_overs"], counts_table(records))
    # The speeds are of all these rows together: some of them alone would be another sample.
    pooled = [
        bool(logs[row])
        for row in grid
        if (row.split, row.planner, row.fallback, row.rolling) == ("eval", "closed", "oracle", 0.0)
    ]
    return {**tables, "release-speed": release_speeds(analysis.placements)} if pooled and all(pooled) else tables
