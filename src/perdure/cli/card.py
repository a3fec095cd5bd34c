"""``perdure card``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from perdure.cli.parse import parse
from perdure.cli.report import find_table


@dataclass(frozen=True)
class CardFlags:
    """Write a policy's model card in the format of Hugging Face: README.md beside its file."""

    policy: tyro.conf.Positional[str]
    """A policy file, a folder that holds one, or the name of a shipped policy."""
    table: Path
    """The table of `perdure extrapolate` that holds the policy's episodes: lanes.parquet, or its folder."""
    out: Path | None = None
    """The file to write; by default README.md in the policy's folder, or STEM.README.md if that holds several policies.
    Required for shipped and downloaded policies."""


def main(args: list[str]) -> None:
    """``perdure card``."""
    flags = parse(CardFlags, args, "card")
    from perdure.extrapolate.card import write_card

    print(write_card(flags.policy, find_table(flags.table), flags.out))
