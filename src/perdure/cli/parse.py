"""Parse a command line by the signature of a function, in the same way for every command; flags that commands share.

tyro does the work. Added are numbers such as 1e5, errors of one line, and help that begins with an example and ends
with a link.
"""

from __future__ import annotations

import ast
import errno
import inspect
import io
import os
import re
import sys
from collections.abc import Callable, Mapping
from contextlib import redirect_stderr
from dataclasses import is_dataclass
from functools import partial
from itertools import pairwise
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
Normalizer = Annotated[
    str | None,
    tyro.conf.arg(
        help='For models of Stable-Baselines3: the file that VecNormalize.save() wrote; "none" if only rewards were '
        "normalized."
    ),
]
TimeFeature = Annotated[
    str | None,
    tyro.conf.arg(
        help="For models of Stable-Baselines3: linear:1000 if trained in sb3-contrib's TimeFeatureWrapper with 1000 "
        "steps; linear takes the training horizon."
    ),
]
TrainingHorizon = Annotated[
    int | None,
    tyro.conf.arg(
        help="For models: steps of a training episode; if left out, what an exported ONNX model says, or the "
        "environment's own step limit."
    ),
]
Trust = Annotated[
    bool,
    tyro.conf.arg(
        help="For models of Stable-Baselines3: load with Stable-Baselines3 itself, which runs code in the files. Only "
        "for files you trust."
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


@NUMBERS.primitive_rule
def _optional_words(info: Any) -> PrimitiveConstructorSpec[tuple[str, ...] | None] | None:
    """Read a flag of several words that has no default; named without a word it is left out."""
    if info.type != (tuple[str, ...] | None):
        return None
    return PrimitiveConstructorSpec(
        "*",
        "[STR [STR ...]]",
        lambda words: tuple(words) or None,
        lambda value: value is None or isinstance(value, tuple),
        lambda value: list(value or ()),
    )


def parse(kind: type[T] | Callable[..., T], args: list[str], command: str) -> T:
    """Return what ``kind``, a function or a dataclass, returns for the arguments of a command line.

    Raises:
        SystemExit: For --help, and with code 2 and one line on stderr for flags that cannot be read.
    """
    box = io.StringIO()
    if {"-h", "--help"} & set(args) and example(command):
        print(f"example: {example(command)}\n")
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


def call(function: Callable[..., T], args: list[str], command: str) -> T:
    """Return what a function, or a dataclass, returns for the arguments of a command line.

    What it prints on stderr while it runs is not held back. A parameter `command` of a function gets the command line
    as text.
    """
    asks_help = not {"-h", "--help"}.isdisjoint(args)
    made = parse(deferred(function, _vocabularies() if asks_help else {}), args, command)
    if "command" in inspect.signature(function).parameters:
        return made(command=whole_command(args, command))
    return made()


def whole_command(args: list[str], command: str) -> str:
    """Return the command line as text."""
    return command_line("perdure", *command.split(), *args)


def _vocabularies() -> dict[str, str]:
    """Return lists that help texts contain, by their placeholder; other packages may add to them."""
    from perdure.disturbances import examples
    from perdure.horizon import clock_examples

    return {"{disturbances}": examples(), "{clocks}": clock_examples()}


def deferred(function: Callable[..., T], listings: Mapping[str, str]) -> Callable[..., partial[T]]:
    """Return a function of the same parameters, without `command`, that returns the call instead of making it.

    Its help texts have the `listings` in place of their names.
    """

    def bind(*arguments: Any, **options: Any) -> partial[T]:
        return partial(function, *arguments, **options)

    hints = get_type_hints(function, include_extras=True)
    signature = inspect.signature(function)
    shown = [each for each in signature.parameters.values() if each.name != "command"]
    if isinstance(function, type):
        for name, text in field_texts(function).items():
            hints[name] = Annotated[hints[name], tyro.conf.arg(help=_filled(text, listings))]
        order = list(hints)  # that of the fields; of parameters, those by keyword come last
        shown = [
            each.replace(kind=each.KEYWORD_ONLY) for each in sorted(shown, key=lambda each: order.index(each.name))
        ]
    bind.__signature__ = signature.replace(parameters=shown)  # type: ignore[attr-defined]
    bind.__annotations__ = {each.name: hints[each.name] for each in shown}
    # tyro keeps the line breaks inside the description of a parameter.
    bind.__doc__ = _filled(re.sub(r"\n {8,}", " ", inspect.getdoc(function) or ""), listings)
    return bind


def _filled(text: str, listings: Mapping[str, str]) -> str:
    """Return a help text with the lists in place of their names."""
    for placeholder, listing in listings.items():
        text = text.replace(placeholder, listing)
    return text


def field_texts(kind: type) -> dict[str, str]:
    """Return what the docstrings under the fields of a dataclass and of its bases say, each in one line."""
    texts = {}
    for base in reversed(kind.__mro__):
        if not is_dataclass(base):
            continue
        body = ast.parse(inspect.getsource(base)).body[0]
        assert isinstance(body, ast.ClassDef)
        for field, text in pairwise(body.body):
            if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant):
                texts[ast.unparse(field.target)] = " ".join(str(text.value.value).split())
    return {name: text for name, text in texts.items() if not name.startswith("_")}


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
