"""``perdure inspect``."""

from __future__ import annotations

from dataclasses import dataclass

import tyro

from perdure.cli.parse import parse


@dataclass(frozen=True)
class InspectFlags:
    """Show what a policy file contains."""

    policy: tyro.conf.Positional[str]
    """A policy file, or the name of a shipped policy."""


def main(args: list[str]) -> None:
    """``perdure inspect``."""
    flags = parse(InspectFlags, args, "inspect")
    from perdure.cli import texts
    from perdure.policy import load_policy
    from perdure.policy.shipped import find_policy

    print(texts.policy(load_policy(find_policy(flags.policy))))
