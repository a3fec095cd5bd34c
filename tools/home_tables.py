"""Write tables of the placement study into docs/home: `python tools/home_tables.py`.

It reads only the tables in results/placement/tables, which `python -m studies placement --scale thesis` writes.
"""

from __future__ import annotations

import sys
from pathlib import Path

from marks import put

from perdure.runs import write_atomic

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))
PAGES = {
    "docs/home/world.md": ("hand_over", "hand-over"),
    "docs/home/training.md": ("halt_in_noise", "halt-in-noise"),
}
"""Page to the mark in it and the table that stands there."""


def filled(root: Path, page: str) -> str:
    """Return a page with its table between its marks."""
    from studies.files import markdown_table
    from studies.placement.tables import PAGE_TABLES, read_tables

    mark, table = PAGES[page]
    tables = read_tables(root / "results" / "placement" / "tables")
    return put((root / page).read_text(), mark, markdown_table(PAGE_TABLES[table](tables)))


if __name__ == "__main__":
    for name in PAGES:
        write_atomic(ROOT / name, filled(ROOT, name))
