"""Write docs/reference/contract.md from the declaration of contracts, as part of `make docs`."""

from __future__ import annotations

import math
from typing import Any

from msgspec import NODEFAULT
from msgspec.structs import fields

from perdure.robots.contract import REQUIRED, Contract, RandomCommands, Term, field_texts
from perdure.robots.terms import ObservationTerm

HEAD = """# Contract of a robot

The fields of the YAML file. Values of joints are one number, a list in the order of `joints`, or a table from regular
expressions of their names. `perdure robot init robot.xml` writes a draft
([robot to verdict](../how-to/robot-to-verdict.md)).
"""


def page() -> str:
    """Return the whole page as Markdown."""
    parts = [HEAD, _fields(Contract), "## A term of `observations`", _fields(Term), "## `random`"]
    rows = [
        f"| `{name}` | {kind.words} | {', '.join(kind.aliases)} |" for name, kind in ObservationTerm.kinds().items()
    ]
    terms = ["| term | value | other names |", "|---|---|---|", *rows]
    return "\n\n".join([*parts, _fields(RandomCommands), "## Observation terms", "\n".join(terms)]) + "\n"


def _fields(kind: type) -> str:
    """Return the table of one declared table's fields."""
    texts = field_texts(kind)
    rows = [f"| `{each.name}` | {texts[each.name]} | {_default(kind, each)} |" for each in fields(kind)]
    return "\n".join(["| field | meaning and unit | default |", "|---|---|---|", *rows])


def _default(kind: type, field: Any) -> str:
    if field.default is NODEFAULT or (kind is Contract and field.name in REQUIRED):
        return "required"
    if field.default in (None, (), ""):
        return ""
    if field.default == math.inf:
        return "no limit"
    return f"`{field.default}`"
