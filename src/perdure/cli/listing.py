"""``perdure list``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import tyro

from perdure.cli.parse import parse


@dataclass(frozen=True)
class ListFlags:
    """Show what there is."""

    what: tyro.conf.Positional[Literal["tasks", "methods", "policies"]] = "tasks"
    """tasks, methods or policies (those shipped with perdure)."""
    suite: str | None = None
    """Only tasks of this suite."""


def main(args: list[str]) -> None:
    """``perdure list``."""
    flags = parse(ListFlags, args, "list")
    from perdure.cli import texts

    print({"tasks": lambda: texts.tasks(flags.suite), "methods": texts.methods, "policies": texts.policies}[
        flags.what
    ]())  # fmt: skip
