"""Write pages, or the text between two marks of a page, anew."""

from __future__ import annotations

import sys
from pathlib import Path


def write_changed(path: Path, text: str) -> None:
    """Write a page; leave an unchanged one alone, so that Sphinx does not read it again."""
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def put(page: str, mark: str, text: str) -> str:
    """The page with what stands between `<!-- mark: begin -->` and `<!-- mark: end -->` replaced."""
    begin = f"<!-- {mark}: begin -->"
    end = f"<!-- {mark}: end -->"
    before, _, rest = page.partition(begin)
    _, found, after = rest.partition(end)
    if not found:
        sys.exit(f"the page lacks the marks {begin} and {end}")
    return f"{before}{begin}\n\n{text}\n\n{end}{after}"
