"""Parse a command line by the signature of a function, in the same way for every command; flags that commands share.

tyro does the work. Added are numbers such as 1e5, errors of one line, and help that begins with an example and ends
with a link.
"""

from __future__ import annotations

import errno
import inspect
import io
import os
import re
import sys
from collections.abc import Callable, Mapping
from contextlib import redirect_stderr
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast, get_type_hints

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec

from perdure.cli import DOCS, command_line, example

T = TypeVar("T")
Cores = Annotated[int | None, tyro.conf.arg(help="Cores to use; all by default. Results do not depend on it.")]
On = Annotated[
    str,
    tyro.conf.arg(
        help="Where to run: here (this process), local (a process for each core), ray (a local Ray) or ray:ADDRESS (a "
        "Ray cluster)."
    ),
]

FRAME = "│╭╮╰╯─ "
"""Characters of the boxes that tyro draws."""
NUMBERS = ConstructorRegistry()


@NUMBERS.primitive_rule
def _whole_numbers(info: Any) -> PrimitiveConstructorSpec[int] | None:
    if info.type is not int:
        return None
    return PrimitiveConstructorSpec(1, "INT", _whole, lambda n: type(n) is int, lambda n: [str(n)])


def _whole(words: list[str]) -> int:
    """Return 100000 for 1e5, and for 100000."""
    if re.fullmatch(r"\d+(\.\d+)?[eE]\+?\d{1,2}", words[0]) and float(words[0]).is_integer():
        return int(float(words[0]))
    return int(words[0])


def parse(kind: type[T] | Callable[..., T], args: list[str], command: str) -> T:
    """Return what ``kind``, a function or a dataclass, returns for the arguments of a command line.

    Raises:
        SystemExit: For --help, and with code 2 and one line on stderr for flags that cannot be read.
    """
    box = io.StringIO()
    if {"-h", "--help"} & set(args) and (shown := example(command)):
        print(f"example: {shown}\n")
    try:
        with redirect_stderr(box):
            filled: T = tyro.cli(
                cast(Any, kind),
                args=args,
                prog=f"perdure {command}",
                config=(tyro.conf.AvoidSubcommands,),
                registry=NUMBERS,
            )
        return filled
    except SystemExit as end:
        if not end.code:  # --help
            print(f"More: {DOCS}")
            raise
        print(f"perdure: {sentence(box.getvalue())}; see perdure {command} --help", file=sys.stderr)
        raise SystemExit(2) from None


def call(function: Callable[..., None], args: list[str], command: str) -> None:
    """Call a function with arguments from a command line; what it prints on stderr while it runs is not held back.

    A parameter `command` of the function gets the command line as text.
    """
    asks_help = not {"-h", "--help"}.isdisjoint(args)
    made = parse(deferred(function, _vocabularies() if asks_help else {}), args, command)
    known = {"command": command_line("perdure", *command.split(), *args)}
    made(**{name: text for name, text in known.items() if name in inspect.signature(function).parameters})


def _vocabularies() -> dict[str, str]:
    """Return lists that help texts contain, by their placeholder; other packages may add to them."""
    from perdure.disturbances import examples

    return {"{disturbances}": examples()}


def deferred(function: Callable[..., None], listings: Mapping[str, str]) -> Callable[..., partial[None]]:
    """Return a function of the same parameters, without `command`, that returns the call instead of making it.

    Its help texts have the `listings` in place of their names.
    """

    def bind(*arguments: Any, **options: Any) -> partial[None]:
        return partial(function, *arguments, **options)

    hints, signature = get_type_hints(function, include_extras=True), inspect.signature(function)
    shown = [each for each in signature.parameters.values() if each.name != "command"]
    bind.__signature__ = signature.replace(parameters=shown)  # type: ignore[attr-defined]
    bind.__annotations__ = {each.name: hints[each.name] for each in shown}
    # tyro keeps the line breaks inside the description of a parameter.
    text = re.sub(r"\n {8,}", " ", inspect.getdoc(function) or "")
    for placeholder, listing in listings.items():
        text = text.replace(placeholder, listing)
    bind.__doc__ = text
    return bind


def check_folder(path: Path) -> None:
    """Raise NotADirectoryError if `path`, or a parent folder of it, is a file."""
    for each in (path, *path.parents):
        if each.exists():
            if not each.is_dir():
                raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(path))
            return


def sentence(box: str) -> str:
    """Return the first sentence of a framed message, without a period, and the flag that the user may have meant.

    Args:
        box: As tyro prints it to a terminal: the words up to its first rule say what is wrong.
    """
    lines = box.splitlines()
    inside = [line.strip(FRAME) for line in (lines[1:] if box.startswith("╭") else lines)]
    words = " ".join(inside[: inside.index("")] if "" in inside else inside)
    nearest = re.search(r"(?:Perhaps you meant|similar to).*?(--[\w.-]+)", " ".join(inside))
    return words.removeprefix("Error parsing ").rstrip(".") + (f"; did you mean {nearest[1]}?" if nearest else "")
