"""Parse flags to a dataclass, in the same way for every command."""

from __future__ import annotations

import errno
import io
import os
import re
import sys
from contextlib import redirect_stderr
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

import tyro

T = TypeVar("T")

FRAME = "│╭╮╰╯─ "
"""Characters of the boxes that tyro draws."""


def parse(kind: type[T], args: list[str], command: str, default: T | None = None) -> T:
    """Return the dataclass ``kind`` filled from flags; ``default`` gives the values of flags that are left out.

    Raises:
        SystemExit: For --help, and with code 2 and one line on stderr for flags that cannot be read.
    """
    box, args = io.StringIO(), _whole_numbers(args, _whole_flags(kind))
    try:
        with redirect_stderr(box):
            return _fill(kind, args, f"perdure {command}", default)
    except SystemExit as end:
        if not end.code:  # --help
            raise
        wrong = sentence(box.getvalue())
        print(f"perdure: {wrong}{_nearest_flag(kind, wrong, default)}; see perdure {command} --help", file=sys.stderr)
        raise SystemExit(2) from None


def flag_name(arg: str) -> str:
    """Return the flag of an argument: "--eval-seed" for "--eval_seed=1"; any other argument unchanged."""
    return arg.partition("=")[0].replace("_", "-") if arg.startswith("--") else arg


def check_folder(path: Path) -> None:
    """Raise NotADirectoryError if `path`, or a parent folder of it, is a file."""
    for each in (path, *path.parents):
        if each.exists():
            if not each.is_dir():
                raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(path))
            return


def _whole_flags(kind: Any, prefix: str = "--") -> set[str]:
    """Return the flags of a dataclass whose values are whole numbers, those of its dataclasses included."""
    found: set[str] = set()
    hints = get_type_hints(kind)
    for each in fields(kind):
        name, hint = f"{prefix}{each.name.replace('_', '-')}", hints[each.name]
        if is_dataclass(hint):
            found |= _whole_flags(hint, f"{name}.")
        elif int in _parts(hint):
            found.add(name)
    return found


def _parts(hint: Any) -> set[Any]:
    """Return the classes that a type hint is made of: {int, NoneType} for int | None."""
    inner = get_args(hint)
    return {hint} if not inner else {part for each in inner for part in _parts(each)}


def _whole_numbers(args: list[str], flags: set[str]) -> list[str]:
    """Return the arguments with numbers such as 1e5 written out behind these flags."""
    found, counts = list[str](), False
    for arg in args:
        if arg.startswith("--"):
            counts = flag_name(arg) in flags
            name, equals, value = arg.partition("=")
            found.append(f"{name}={_whole(value)}" if counts and equals else arg)
        else:
            found.append(_whole(arg) if counts else arg)
    return found


def _whole(arg: str) -> str:
    """Return 100000 for 1e5, anything else unchanged."""
    if re.fullmatch(r"\d+(\.\d+)?[eE]\+?\d{1,2}", arg) and float(arg).is_integer():
        return str(int(float(arg)))
    return arg


def _nearest_flag(kind: type[T], wrong: str, default: T | None) -> str:
    """Return "; did you mean --x?" for a message about an unknown flag --y, nothing for others."""
    found = re.match(r"Unrecognized options: (--[\w.-]+)", wrong)
    if found is None:
        return ""
    config = (tyro.conf.AvoidSubcommands,)
    parser = (
        tyro.extras.get_parser(kind, config=config)
        if default is None
        else tyro.extras.get_parser(kind, config=config, default=default)
    )
    flags = [flag for action in parser._actions for flag in action.option_strings if flag.startswith("--")]
    nearest = get_close_matches(found[1], flags, n=1, cutoff=0.6)
    return f"; did you mean {nearest[0]}?" if nearest else ""


def _fill(kind: type[T], args: list[str], prog: str, default: T | None) -> T:
    config = (tyro.conf.AvoidSubcommands,)
    if default is None:
        return tyro.cli(kind, args=args, prog=prog, config=config)
    return tyro.cli(kind, args=args, prog=prog, config=config, default=default)


def sentence(box: str) -> str:
    """Return the first sentence of a framed message: the words from its title to its first rule, without a period.

    Args:
        box: As tyro prints it to a terminal.
    """
    lines = box.splitlines()
    words: list[str] = []
    for line in lines[1:] if box.startswith("╭") else lines:
        inside = line.strip(FRAME)
        if not inside:  # a rule, or the lower edge
            break
        words.append(inside)
    return " ".join(words).removeprefix("Error parsing ").rstrip(".")
