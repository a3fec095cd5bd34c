"""One HTML document that needs no network: figures that plotly.js draws, tables, the command that made it."""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from pathlib import Path

from perdure.report.charts import Chart
from perdure.report.plotly_renderer import render_plotly

_STYLE = (Path(__file__).parent / "page.css").read_text(encoding="utf-8")
_SCRIPT = (Path(__file__).parent / "page.js").read_text(encoding="utf-8")


def page(title: str, parts: Sequence[str], command: str) -> str:
    """The whole page.

    Args:
        title: Of the window, plain text.
        parts: HTML, one after the other.
        command: What made it; shown last so that a reader can repeat it. "": not recorded.
    """
    from plotly.offline import get_plotlyjs

    shown = html.escape(command) if command else "not recorded"
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<link rel="icon" href="data:,"><title>{html.escape(title)}</title>'
        f"<style>{_STYLE}</style><script>{get_plotlyjs()}</script></head><body><main>"
        f"{''.join(parts)}"
        f"<section><h2>Command</h2><pre>{shown}</pre></section></main><script>{_SCRIPT}</script></body></html>\n"
    )


def header(task: str, sentence: str) -> str:
    """A task's name over the sentence that sums it up, both plain text."""
    return f"<header><p class='task'>{html.escape(task)}</p><h1>{html.escape(sentence)}</h1></header>"


def figures(charts: Sequence[Chart]) -> str:
    """Charts beside each other where the page is wide enough."""
    return f"<div class='figures'>{''.join(map(figure, charts))}</div>"


def figure(chart: Chart) -> str:
    """A chart with its title and its note, in the colours of a light and of a dark page."""
    both = {"light": render_plotly(chart, dark=False), "dark": render_plotly(chart, dark=True)}
    # "</" would end the script element; inside a JSON string it may be written with an escaped slash.
    data = json.dumps(both, allow_nan=False).replace("</", "<\\/")
    kind = " class='wide'" if chart.wide else ""
    return (
        f"<figure id='{chart.name}'{kind}><figcaption>{html.escape(chart.title)}</figcaption><div class='plot'></div>"
        f"<script type='application/json'>{data}</script><p class='note'>{html.escape(chart.note)}</p></figure>"
    )


def table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]], note: str = "") -> str:
    """A table of plain text with its title.

    Args:
        title: Above it.
        headings: One for each column.
        rows: Cells, as many in each row as there are headings.
        note: Below it, plain text.
    """
    head = "".join(f"<th>{html.escape(name)}</th>" for name in headings)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    below = f"<p class='note'>{html.escape(note)}</p>" if note else ""
    return (
        f"<section><h2>{html.escape(title)}</h2><div class='scroll'><table><thead><tr>{head}</tr></thead>"
        f"<tbody>{body}</tbody></table></div>{below}</section>"
    )


def text(title: str, markup: str) -> str:
    """A paragraph with its title; `markup` is HTML."""
    return f"<section><h2>{html.escape(title)}</h2><p>{markup}</p></section>"
