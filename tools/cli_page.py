"""Write the reference of the command line from the parsers that the commands themselves use."""

from __future__ import annotations

import io
import re
import warnings
from contextlib import redirect_stdout
from functools import cache
from typing import Any
from unittest.mock import patch

import tyro

from perdure import cli

HEAD = """# Command line

This page is generated from the commands themselves. `perdure COMMAND --help` shows the same text. Whole numbers may be
written as `100000`, `100_000` or `1e5`. A wrong flag or value ends with one line on stderr and exit code 2.
"""


def commands() -> tuple[str, ...]:
    """Return the name of every command, such as "home run"."""
    return (*(name for name in cli.COMMANDS if name != "home"), *(f"home {name}" for name in cli.HOME_COMMANDS))


class _SeenError(Exception):
    """Carries what a command gave to tyro."""


@cache
def parser(command: str) -> Any:
    """Return the argparse parser of a command: that of the function or dataclass which it gives to tyro for --help."""

    def seen(kind: Any, *, args: Any, **options: Any) -> None:
        raise _SeenError(kind, options)

    try:
        with patch("tyro.cli", seen), redirect_stdout(io.StringIO()):
            cli.run([*command.split(), "--help"])
    except _SeenError as found:
        kind, options = found.args
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            return tyro.extras.get_parser(kind, **options)
    raise AssertionError(f"perdure {command} --help did not call tyro")


def flags(command: str) -> set[str]:
    """Return every flag of a command, with both forms of a switch (`--x`, `--no-x`)."""
    found: set[str] = set()
    for action in parser(command)._actions:
        found.update(action.option_strings)
    return found


def section(command: str) -> str:
    """Return the section of one command: what it does, its arguments and its flags."""
    rows = [_row(action) for action in parser(command)._actions if action.dest != "help"]
    usage = " ".join(["perdure", command, *(name for name, is_flag, *_ in rows if not is_flag), "[flags]"])
    lines = [f"## perdure {command}", "", _text(parser(command).description or ""), "", f"`{usage}`", ""]
    example = cli.example(command)
    if example:
        lines += [f"Example: `{example}`", ""]
    if command == "train":
        lines += [
            "Task, method and preset decide the defaults of `--ppo.*`; `perdure train TASK --help` shows them.",
            "",
        ]
    if rows:
        lines += ["| argument | meaning |", "|---|---|", *(_table_row(*row) for row in rows)]
    return "\n".join([*lines, ""])


def _row(action: Any) -> tuple[str, bool, str, str, str]:
    is_flag = bool(action.option_strings)
    name = action.option_strings[0] if is_flag else action.dest.upper().replace("-", "_")
    value = re.sub(r"^\[+(\w+) \[\1 \.\.\.\]\]+$", r"\1 ...", (action.metavar or "").replace("{None}|", ""))
    # tyro writes the default behind the help.
    text, _, rest = (action.help or "").replace("%%", "%").rpartition("(default:")
    default = rest.rstrip(")").strip()
    if not text:
        text = re.sub(r"\((required|fixed to:.*)\)$", "", action.help or "")
        default = ""
    if default == "None" or not value:
        default = ""
    return name, is_flag, value, default, _text(text)


def _table_row(name: str, is_flag: bool, value: str, default: str, text: str) -> str:
    shown = name
    if is_flag:
        shown = f"{name} {value}".strip()
    meaning = text.removesuffix(".") + "."
    if default:
        meaning += f" Default: {_code(default)}."
    return f"| {_code(shown)} | {meaning} |"


def _text(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("``", "`")


def _code(text: str) -> str:
    if not text:
        return ""
    return f"`{text}`".replace("|", "\\|")


def page() -> str:
    """Return the whole page."""
    return "\n".join([HEAD, *map(section, commands())])
