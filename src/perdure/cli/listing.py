"""``perdure list``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import tyro

from perdure.cli.errors import CommandError
from perdure.cli.parse import parse


@dataclass(frozen=True)
class ListFlags:
    """List tasks, training methods, or the policies that come with perdure."""

    what: tyro.conf.Positional[Literal["tasks", "methods", "policies"]] = "tasks"
    """What to list."""
    suite: str | None = None
    """Only tasks of this suite."""


def main(args: list[str]) -> None:
    """``perdure list``."""
    flags = parse(ListFlags, args, "list")
    from perdure.cli import texts

    if flags.suite is not None and flags.what != "tasks":
        raise CommandError(f"--suite is for tasks, not for {flags.what}")

    print({"tasks": lambda: texts.tasks(flags.suite), "methods": texts.methods, "policies": texts.policies}[
        flags.what
    ]())  # fmt: skip
