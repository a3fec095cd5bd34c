"""Write the tables and pictures of the placement study into README.md and docs/home: `python tools/home_tables.py`.

It reads only the tables in results/placement/tables, which `perdure study placement --scale thesis` writes.
docs/images/home-release-strategies.png is drawn from strategies.json, home-release-speed.png from release-speed.csv.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from marks import put

from perdure.report.render import Figure, render
from perdure.runs import write_atomic
from perdure.studies.placement.analyze import make_figures
from perdure.studies.placement.markdown import TABLES, readme_table
from perdure.studies.placement.markdown_measured import hand_over_measured, noise_measured
from perdure.studies.placement.release_speed import speed_table
from perdure.studies.placement.tables import Tables, read_tables

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "results" / "placement"
PICTURES = {"strategies": "home-release-strategies.png", "release-speed": "home-release-speed.png"}
"""Figure of the study to its file in docs/images."""


def tables_by_page(tables: Tables) -> dict[str, dict[str, str]]:
    """Return page to the tables in it, each by its mark."""
    results = tables.results
    made = {mark: table(results.rows, results.pairs) for mark, table in TABLES.items()}
    return {
        "README.md": {"home results": readme_table(results.rows)},
        "docs/home/results.md": {**made, "release_speed": speed_table(tables.speeds)},
        "docs/home/world.md": {"hand_over": hand_over_measured(tables.hand_over)},
        "docs/home/training.md": {"halt_in_noise": noise_measured(tables.noise)},
    }


def pictures(tables: Tables) -> dict[str, Figure]:
    """Return file name in docs/images to the figure."""
    return {PICTURES[figure.name]: figure for figure in make_figures(tables) if figure.name in PICTURES}


def filled(page: str, tables: Mapping[str, str]) -> str:
    """Return a page with its tables between their marks."""
    for mark, text in tables.items():
        page = put(page, mark, text)
    return page


def update_docs(root: Path, results: Path) -> None:
    """Write the tables of a folder of results into the pages under `root`, and the pictures beside them."""
    tables = read_tables(results)
    for page, texts in tables_by_page(tables).items():
        write_atomic(root / page, filled((root / page).read_text(), texts))
    for name, figure in pictures(tables).items():
        write_atomic(root / "docs" / "images" / name, render(figure))


if __name__ == "__main__":
    update_docs(ROOT, RESULTS)
