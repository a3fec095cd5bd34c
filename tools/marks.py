"""Text between two marks of a Markdown page, which a script writes anew."""

from __future__ import annotations

import sys


def put(page: str, mark: str, text: str) -> str:
    """The page with what stands between `<!-- mark: begin -->` and `<!-- mark: end -->` replaced."""
    begin, end = f"<!-- {mark}: begin -->", f"<!-- {mark}: end -->"
    before, _, rest = page.partition(begin)
    _, found, after = rest.partition(end)
    if not found:
        sys.exit(f"the page lacks the marks {begin} and {end}")
    return f"{before}{begin}\n\n{text}\n\n{end}{after}"
