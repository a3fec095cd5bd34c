"""Write the reference of the command line from the parsers that the commands themselves use."""

from __future__ import annotations

import dataclasses
import re
import sys
import warnings
from importlib import import_module
from pathlib import Path
from typing import Any

import tyro

from perdure.cli import COMMANDS, home

HEAD = """# Command line

This page is generated from the commands themselves. `perdure COMMAND --help` shows the same text. Whole numbers may be
written as `100000`, `100_000` or `1e5`. A wrong flag or value ends with one line on stderr and exit code 2.
"""


def commands() -> dict[str, str]:
    """Return every command, such as "home run", with the module that carries it out."""
    outer = {name: module for name, module in COMMANDS.items() if name != "home"}
    return outer | {f"home {name}": f"home.{name}" for name in home.COMMANDS}


def section(command: str, module: str) -> str:
    """Return the section of one command: what it does, its arguments and its flags."""
    kind = _flags(import_module(f"perdure.cli.{module}"))
    parser = _parser(kind)
    rows = [_row(action) for action in parser._actions if action.dest != "help"]
    usage = " ".join(["perdure", command, *(name for name, is_flag, *_ in rows if not is_flag), "[flags]"])
    lines = [f"## perdure {command}", "", _text(kind.__doc__ or ""), "", f"`{usage}`", ""]
    if command == "train":
        lines += [
            "Task, method and preset decide the defaults of `--ppo.*`; `perdure train TASK --help` shows them.",
            "",
        ]
    if rows:
        lines += ["| argument | meaning |", "|---|---|", *(_table_row(*row) for row in rows)]
    return "\n".join([*lines, ""])


def flags(module: str) -> set[str]:
    """Return every flag of a command's module, with both forms of a switch (`--x`, `--no-x`)."""
    parser = _parser(_flags(import_module(f"perdure.cli.{module}")))
    return {option for action in parser._actions for option in action.option_strings}


def _flags(module: Any) -> Any:
    """Return the dataclass that holds a command's flags: the one that its module defines."""
    (kind,) = [
        each
        for each in vars(module).values()
        if isinstance(each, type) and dataclasses.is_dataclass(each) and each.__module__ == module.__name__
    ]
    return kind


def _parser(kind: type) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return tyro.extras.get_parser(kind, config=(tyro.conf.AvoidSubcommands,))


def _row(action: Any) -> tuple[str, bool, str, str, str]:
    text, _, rest = (action.help or "").replace("%%", "%").rpartition("(default:")
    default = rest.rstrip(")").strip() if text else ""
    text = text if text else re.sub(r"\((required|fixed to:.*)\)$", "", action.help or "")
    is_flag = bool(action.option_strings)
    name = action.option_strings[0] if is_flag else action.dest.upper().replace("-", "_")
    value = re.sub(r"^\[+(\w+) \[\1 \.\.\.\]\]+$", r"\1 ...", (action.metavar or "").replace("{None}|", ""))
    return name, is_flag, value, "" if default == "None" or not value else default, _text(text)


def _table_row(name: str, is_flag: bool, value: str, default: str, text: str) -> str:
    shown = f"{name} {value}".strip() if is_flag else name
    end = f" Default: {_code(default)}." if default else ""
    return f"| {_code(shown)} | {text}{'' if text.endswith('.') else '.'}{end} |"


def _text(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("``", "`")


def _code(text: str) -> str:
    return f"`{text}`".replace("|", "\\|") if text else ""


def page() -> str:
    """Return the whole page."""
    return "\n".join([HEAD, *(section(command, module) for command, module in commands().items())])


def write(path: Path) -> None:
    """Write the page; an unchanged one is left alone."""
    text = page()
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    write(Path(sys.argv[1]))
