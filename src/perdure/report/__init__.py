"""Reports: figures and an HTML page from extrapolation tables, without simulation.

    schema.py           the Parquet table: columns, version, read_table, write_table
    lanes.py            one row for each lane (deployed episode), curves as matrices
    statistics.py       estimates with intervals: training runs are the units
    groups.py           the lanes of a table that share policy, clock and task
    theme.py            colors, dash patterns, shapes, fonts, sizes
    axes.py             what all charts share
    curves.py           charts of curves
    rows.py             charts with rows of points or bars
    render.py           Figure: a chart with title and note, as PNG, SVG, PDF, or as a specification in a page
    figures.py          which figures a table gives
    table.py            the summary table
    verdict.py          the verdict on each policy and clock, and its sentence
    document.py         a self-contained HTML document of figures and tables
    page.py             write_report: the page of a table, the figures as files beside it
    errors.py           ReportError

Charts are Altair's; vl-convert draws them. `theme`, `axes`, `curves` and `rows` do not depend on tables. Of perdure the
package imports only `schema` and `runs.write_atomic`. Its modules are loaded at first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from perdure.report.errors import ReportError

if TYPE_CHECKING:
    from perdure.report.page import estimate_table, summary_text, write_report
    from perdure.report.schema import (
        COLUMNS,
        SCHEMA_NAME,
        SCHEMA_VERSION,
        check_table,
        read_lanes,
        read_table,
        write_table,
    )
    from perdure.report.statistics import (
        Bootstrap,
        Interval,
        Units,
        bootstrap_interval,
        difference_interval,
        estimate_interval,
        make_units,
        mean_interval,
        survival_interval,
        t_interval,
    )

__all__ = [
    "COLUMNS",
    "SCHEMA_NAME",
    "SCHEMA_VERSION",
    "Bootstrap",
    "Interval",
    "ReportError",
    "Units",
    "bootstrap_interval",
    "check_table",
    "difference_interval",
    "estimate_interval",
    "estimate_table",
    "make_units",
    "mean_interval",
    "read_lanes",
    "read_table",
    "summary_text",
    "survival_interval",
    "t_interval",
    "write_report",
    "write_table",
]

_NAMES = {
    "page": ("estimate_table", "summary_text", "write_report"),
    "schema": ("COLUMNS", "SCHEMA_NAME", "SCHEMA_VERSION", "check_table", "read_lanes", "read_table", "write_table"),
    "statistics": (
        *("Bootstrap", "Interval", "Units", "bootstrap_interval"),
        *("difference_interval", "estimate_interval", "make_units", "mean_interval"),
        *("survival_interval", "t_interval"),
    ),
}
_HOME = {name: module for module, names in _NAMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
