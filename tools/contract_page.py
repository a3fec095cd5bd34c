"""Write docs/reference/contract.md from the declaration of contracts, as part of `make docs`."""

from __future__ import annotations

import math
from typing import Any

from msgspec import NODEFAULT
from msgspec.structs import fields

from perdure.robots.contract import REQUIRED, Contract, HeldJoints, RandomCommands, Term, field_texts
from perdure.robots.readers import ContractReader
from perdure.robots.terms import ObservationTerm

HEAD = """# Contract of a robot

The fields of the YAML file. Values of joints are one number, a list in the order of `joints`, or a table from regular
expressions of their names. `perdure robot init robot.xml` writes a draft
([robot to verdict](../how-to/robot-to-verdict.md)).
"""


def page() -> str:
    """Return the whole page as Markdown."""
    parts = [HEAD, _fields(Contract)]
    for title, kind in (("A term of `observations`", Term), ("`held`", HeldJoints), ("`random`", RandomCommands)):
        parts += [f"## {title}", _fields(kind)]
    parts += ["## Observation terms", _terms(), "## Files that are read", _formats()]
    return "\n\n".join(parts) + "\n"


def _terms() -> str:
    """Return the table of the observation terms."""
    rows = [
        f"| `{name}` | {kind.words} | {', '.join(kind.aliases)} |" for name, kind in ObservationTerm.kinds().items()
    ]
    return "\n".join(["| term | value | other names |", "|---|---|---|", *rows])


def _formats() -> str:
    """Return the table of the formats that hold a contract."""
    rows = [f"| `{name}` | {kind.words} |" for name, kind in ContractReader.kinds().items()]
    return "\n".join(["| format | files |", "|---|---|", *rows])


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
