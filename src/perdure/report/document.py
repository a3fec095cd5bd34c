"""Build an HTML document that works offline: figures that Vega draws, tables, the command that made it.

Every text is escaped. The document's policy (Content-Security-Policy) lets run only the two scripts that stand in it,
named by their SHA-256, forbids eval and every request.
"""

from __future__ import annotations

import base64
import hashlib
import html
from collections.abc import Sequence
from pathlib import Path

from perdure.report.render import Figure, javascript, script_json
from perdure.report.theme import DARK
from perdure.schema import printable

_STYLE = (Path(__file__).parent / "page.css").read_text(encoding="utf-8")
_SCRIPT = (Path(__file__).parent / "page.js").read_text(encoding="utf-8")


def page(title: str, parts: Sequence[str], command: str) -> str:
    """Return the whole page.

    Args:
        title: Of the window, plain text.
        parts: HTML, one after the other.
        command: What made it; shown last so that a reader can repeat it. "": not recorded.
    """
    shown = html.escape(printable(command, lines=True)) if command else "not recorded"
    scripts = [text.replace("</script", "<\\/script") for text in (javascript(), _SCRIPT)]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{_policy(scripts)}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<link rel="icon" href="data:,"><title>{html.escape(title)}</title>'
        f"<style>{_STYLE}</style></head><body><main>"
        f"{''.join(parts)}"
        f"<section><h2>Command</h2><pre>{shown}</pre></section></main>"
        f"<script type='application/json' id='dark'>{script_json(DARK)}</script>"
        f"{''.join(f'<script>{text}</script>' for text in scripts)}</body></html>\n"
    )


def _policy(scripts: Sequence[str]) -> str:
    digests = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in scripts]
    allowed = " ".join(f"'sha256-{digest}'" for digest in digests)
    # Vega sets style attributes; they can request nothing that default-src and img-src do not allow.
    return (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )


def header(task: str, sentence: str, points: Sequence[str] = ()) -> str:
    """Return a task's name over the sentence that sums it up and the points behind it, all plain text."""
    items = "".join(f"<li>{html.escape(point)}</li>" for point in points)
    listed = f"<ul>{items}</ul>" if items else ""
    return f"<header><p class='task'>{html.escape(task)}</p><h1>{html.escape(sentence)}</h1>{listed}</header>"


def figures(drawn: Sequence[Figure]) -> str:
    """Return figures beside each other where the page is wide enough."""
    return f"<div class='figures'>{''.join(map(figure, drawn))}</div>"


def figure(drawn: Figure) -> str:
    """Return a figure with its title and its note."""
    kind = " class='wide'" if drawn.wide else ""
    return (
        f"<figure id='{drawn.name}'{kind}><figcaption>{html.escape(drawn.title)}</figcaption><div class='plot'></div>"
        f"<script type='application/json'>{script_json(drawn.spec)}</script>"
        f"<p class='note'>{html.escape(drawn.note)}</p></figure>"
    )


def table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]], note: str = "") -> str:
    """Return a table of plain text with its title.

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
    """Return a paragraph with its title; `markup` is HTML."""
    return f"<section><h2>{html.escape(title)}</h2><p>{markup}</p></section>"
