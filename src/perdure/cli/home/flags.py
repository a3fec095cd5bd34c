"""Flags that several `perdure home` commands share."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

from perdure.cli.parse import flag_name, parse
from perdure.errors import PerdureError

T = TypeVar("T")


RENAMED = {"--lanes": "max_lanes", "--seed": "eval_seed"}
"""Former spelling of a flag to the field that holds it now."""


def parse_home(kind: type[T], args: list[str], command: str) -> T:
    """Return the dataclass `kind` filled from flags, see `perdure.cli.parse.parse`.

    Args:
        kind: The dataclass.
        args: The command line after the command.
        command: Name of the command, such as "run".

    Raises:
        PerdureError: If a former spelling is used.
    """
    for flag in (flag_name(arg) for arg in args):
        if hasattr(kind, field := RENAMED.get(flag, "")):
            raise PerdureError(f"{flag} of perdure home {command} is now {flag_name('--' + field)}")
    return parse(kind, args, f"home {command}")


def log_files(given: tuple[Path, ...]) -> list[Path]:
    """Return the log files among files and folders; PerdureError when there are none."""
    paths = [path for each in given for path in (sorted(each.rglob("*.parquet")) if each.is_dir() else [each])]
    if not paths:
        raise PerdureError(f"there are no logs (*.parquet) in {', '.join(map(str, given)) or 'nothing'}")
    return paths


def policies(written: tuple[str, ...]) -> dict[str, str]:
    """Return SKILL=FILE and SKILL=oracle as a mapping; "oracle" alone means the oracle in every skill.

    Raises:
        PerdureError: For anything else, or a skill that is named twice.
    """
    from perdure.home.skills import SKILLS

    if written == ("oracle",):
        return dict.fromkeys(SKILLS, "oracle")
    names = [each.partition("=")[0] for each in written]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise PerdureError(f"policies must name each skill once; {twice} is named twice: {' '.join(written)}")
    chosen = dict(each.partition("=")[::2] for each in written)
    if not all(chosen.values()):
        raise PerdureError(f"policies are written SKILL=FILE or SKILL=oracle, not {' '.join(written)}")
    return chosen
