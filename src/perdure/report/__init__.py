"""Reports: figures and an HTML page from extrapolation tables, without simulation.

    schema.py      the Parquet table: every column declared once, reading, writing, episodes
    groups.py      groups of episodes: when they fail, failures per hour, whether start states behave as one
    estimates.py   estimates of each group, the verdict on it in words, the best clock
    charts.py      charts as plain functions; a figure as PNG, SVG, PDF, or as a specification in a page
    figures.py     which figures a table gives
    page.py        write_report: `page.html` with figures and tables, the figures beside it; the summary as JSON
    wording.py     numbers for readers

Intervals are from `perdure.stats`. Charts are Vega-Lite specifications, which vl-convert draws; `charts`
does not depend on tables.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from perdure.report.estimates import estimate_table
    from perdure.report.page import summary_text, write_report
    from perdure.report.schema import COLUMNS, SCHEMA_VERSION, read_episodes, read_table, write_table

__all__ = [
    "COLUMNS",
    "SCHEMA_VERSION",
    "estimate_table",
    "read_episodes",
    "read_table",
    "summary_text",
    "write_report",
    "write_table",
]

_HOME = {"estimate_table": "estimates", "summary_text": "page", "write_report": "page"}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME.get(name, 'schema')}"), name)
