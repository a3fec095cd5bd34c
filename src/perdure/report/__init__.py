"""Reports: figures and an HTML page from extrapolation tables, without simulation.

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
