"""Turn the Markdown in docstrings into reStructuredText: code spans, asterisks, tables."""

from __future__ import annotations

import re
from typing import Any

SPAN = re.compile(r"(``(?:[^`]|`(?!`))+``|`[^`]+`)")
NAME = re.compile(r"`(?:[A-Z]\w+|[a-z]+_\w+|(?:\w+\.)+\w+)`")
"""A span that may be the name of something documented: a class, a function, or a dotted path."""

ROLE = re.compile(r":\w+:$")
"""What stands before a span that is reStructuredText already."""
HIDDEN_COLON = "\ue000"
"""Stands for a colon while Napoleon reads a text; a character for private use."""


def process(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Rewrite the lines of one docstring in place; a handler of Sphinx's `autodoc-process-docstring`."""
    lines[:] = spans(tables([line.replace(HIDDEN_COLON, ":") for line in lines]))


def plain_attribute(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Keep Napoleon from reading the words before a colon as the type of an attribute."""
    if what in ("attribute", "data", "property"):
        lines[:] = [line.replace(":", HIDDEN_COLON) for line in lines]


def spans(lines: list[str]) -> list[str]:
    """Return the lines with names as links, other code spans as literals, and plain asterisks escaped."""
    text = "\n".join(lines)
    parts = SPAN.split(text)
    for number, part in enumerate(parts):
        if number % 2 and not ROLE.search(parts[number - 1]):
            after = parts[number + 1][:1]
            if not part.startswith("``") and not NAME.fullmatch(part):
                parts[number] = f"`{part}`"
            if after.isalnum():
                parts[number] += "\\ "
        elif number % 2 == 0:
            parts[number] = re.sub(r"(\*+)(?=\S)", lambda stars: "\\*" * len(stars[1]), part)
    return "".join(parts).split("\n")


def signature(app: Any, what: str, name: str, obj: Any, options: Any, text: str | None, result: str | None) -> Any:
    """Give a signature whose defaults are Python: `...` for what prints as `<factory>`.

    A handler of Sphinx's `autodoc-process-signature`.
    """
    return text and re.sub(r"= ?<[^<>]*>", "=...", text), result


_GAP = r"(?:<[^>]+>|\s)*"
_ARRAY = re.compile(
    _GAP.join(["ndarray", r"\[", "tuple", r"\[", "Any", ",", r"\.\.\.", r"\]", ",", "dtype", ""])
    + rf"\[((?:[^][]|\[[^][]*\])+)\]{_GAP}\]"
)


def short_arrays(app: Any, page: str, template: str, context: dict[str, Any], tree: Any) -> None:
    """Write `NDArray[...]` for an array of any shape, as the source does; a handler of `html-page-context`."""
    if page.startswith("reference/api/") and "body" in context:
        context["body"] = _ARRAY.sub(r'NDArray</span><span class="p"><span class="pre">[\1]', context["body"])


def tables(lines: list[str]) -> list[str]:
    """Return the lines with every Markdown table as a `list-table`."""
    result: list[str] = []
    rows: list[list[str]] = []
    for line in [*lines, ""]:
        if line.lstrip().startswith("|"):
            rows.append([cell.strip() for cell in line.strip().strip("|").split("|")])
            continue
        if rows:
            result += _list_table(rows)
            rows = []
        result.append(line)
    return result


def _list_table(rows: list[list[str]]) -> list[str]:
    header = len(rows) > 1 and all(re.fullmatch(r":?-+:?", cell) for cell in rows[1])
    kept = [row for number, row in enumerate(rows) if not (header and number == 1)]
    text = ["", ".. list-table::", "   :header-rows: 1" if header else "   :header-rows: 0", ""]
    for row in kept:
        text += [f"   {'* -' if number == 0 else '  -'} {cell}" for number, cell in enumerate(row)]
    return [*text, ""]
