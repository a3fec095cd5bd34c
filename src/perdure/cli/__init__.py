"""Command line: each command is a function whose signature and docstring are its flags and its help."""

from __future__ import annotations

import codecs
import os
import shlex
import shutil
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from itertools import pairwise

DOCS = "https://github.com/perdure/perdure/blob/main/docs/index.md"
USAGE = f"""perdure: train a policy in finite episodes, deploy it without end, and know beforehand whether it holds.

  perdure demo                                         two Hoppers, one holds and one falls: a minute, then a page
  perdure train Hopper-v3 --method geometric           train with time-to-go (or plain PPO, or a control)
  perdure extrapolate Hopper-v3/geometric              run policies far beyond their training horizon, and report
  perdure compare Hopper-v3/ppo Hopper-v3/geometric    is B better than A? Episodes are added until it is decided
  perdure cure Hopper-v3/ppo                           train a policy further so that it holds: before and after
  perdure import model.zip --env Hopper-v5             convert a Stable-Baselines3 model to a policy file
  perdure export Hopper-v3/geometric policy.onnx       export a policy as an ONNX model
  perdure report extrapolation                         write the report of an evaluation again
  perdure watch Hopper-v3/ppo --out fall.mp4           film a policy as it fails
  perdure card my-policy --table extrapolation         write a policy's model card
  perdure list policies                                list tasks, methods, policies or disturbances
  perdure inspect Hopper-v3/geometric                  show what a policy file contains
  perdure robot check go2.yaml --policy policy.onnx    do contract, model and policy of a legged robot fit?
  perdure home ...                                     the Home Assistant Benchmark: does the object stay?

Each command explains its options with --help. Documentation: {DOCS}
"""
HOME_USAGE = """perdure home: the Home Assistant Benchmark on MuJoCo.

  perdure home list                          tasks, episodes, skills, objects
  perdure home episode TASK --index 3        starts and goals of an episode; with --render out.png a picture
  perdure home plan TASK                     the task plan, found by a STRIPS planner
  perdure home video TASK --place rl stop    a film of an episode, release strategies side by side
  perdure home view TASK --index 3           an episode live in a browser
  perdure home train SKILL                   train a skill
  perdure home run TASK --place ik           the protocol: episodes x training seeds x evaluation seeds
  perdure home day --errands TASK --hours 4  errand after errand in homes that are never reset
  perdure home analyze LOGS --out PAGE       success per stage, failure causes, placements; with --out as a page
  perdure home failures LOGS                 failed episodes, drawn at random, in pictures: is the label right?

Each command explains its options with --help.
"""


def _names(usage: str, before: str) -> tuple[str, ...]:
    return tuple(line.split()[before.count(" ")] for line in usage.splitlines() if line.startswith(f"  {before}"))


COMMANDS = _names(USAGE, "perdure ")
HOME_COMMANDS = _names(HOME_USAGE, "perdure home ")
MODULES = {
    "demo": "demo",
    "train": "train",
    "extrapolate": "extrapolate",
    "report": "extrapolate",
    "compare": "compare",
    "cure": "cure",
}
"""Modules of commands that are not in `perdure.cli.commands`."""
ALIASES = {"analyse": "analyze"}
RESUMING = ("demo", "train", "extrapolate", "compare", "cure", "home train", "home run", "home day")
"""Commands that keep finished parts of an interrupted run."""


def resumes(args: Sequence[str]) -> bool:
    """Return whether the same command line continues after an interruption."""
    from perdure.cli.subjects import is_function

    command = " ".join(args[: 2 if args and args[0] == "home" else 1])
    subjects = [word for before, word in pairwise(args) if before != "--on"]  # ray:ADDRESS is no MODULE:FUNCTION
    return command in RESUMING and not any(map(is_function, subjects))


def example(command: str) -> str:
    """Return a command line that shows a command, such as "home run"; empty where there is none."""
    lines = (line.strip().partition("  ")[0] for line in (USAGE + HOME_USAGE).splitlines())
    return next((line for line in lines if f"{line} ".startswith(f"perdure {command} ")), "")


def run(args: Sequence[str]) -> None:
    """Run one command line, given without the program's name.

    Raises:
        SystemExit: For --help, and with code 2 for commands that do not exist and flags that cannot be read.
    """
    home = list(args[:1]) == ["home"]
    usage, commands = (HOME_USAGE, HOME_COMMANDS) if home else (USAGE, COMMANDS)
    given = list(args[1:] if home else args)
    command = ALIASES.get(given[0], given[0]) if given else "--help"
    if command in ("-h", "--help"):
        print(usage, end="")
    elif command == "--version" and not home:
        from importlib.metadata import version

        print(f"perdure {version('perdure')}")
    elif command in commands:
        # The commands' modules import much, so --help of the program does not import them.
        module = "home" if home else MODULES.get(command, "commands")
        import_module(f"perdure.cli.{module}").main(command, given[1:])
    else:
        from perdure.errors import did_you_mean

        hint = did_you_mean(command, commands) or f"; the commands are {', '.join(commands)}"
        print(f"perdure: unknown command {'home ' if home else ''}{given[0]!r}{hint}", file=sys.stderr)
        raise SystemExit(2)


# Text that fits the width and encoding of any terminal


NARROWEST = 40
WIDEST = 1000
"""Columns. Where help has no room for a word, the library that draws it never ends; lines are padded to the width."""
_PLAIN = {"\u2212": "-", "\u2013": "-", "\u2014": "-", "\u00b1": "+-", "\u221e": "inf", "\u201c": '"', "\u201d": '"'}


def prepare_terminal() -> None:
    """Bound the width that libraries see, and write characters that the encoding lacks as plain ones."""
    columns = shutil.get_terminal_size().columns
    if not NARROWEST <= columns <= WIDEST:
        os.environ["COLUMNS"] = str(min(max(columns, NARROWEST), WIDEST))
    codecs.register_error("perdure.plain", _plain)
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError):  # not a text stream of Python's own, as under a test
            stream.reconfigure(errors="perdure.plain")  # type: ignore[union-attr]


def command_line(*words: str) -> str:
    """Return a command as text that every file can hold: bytes that are no UTF-8 are written as numbers."""
    return os.fsencode(shlex.join(words)).decode("utf-8", "backslashreplace")


def _plain(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    found = error.object[error.start : error.end]
    return "".join(_PLAIN.get(each) or _escaped(each) for each in found), error.end


def _escaped(character: str) -> str:
    # Python holds a byte that is no text as a surrogate (PEP 383): shown as the byte it is.
    byte = ord(character) - 0xDC00
    return f"\\x{byte:02x}" if 0x80 <= byte <= 0xFF else ascii(character)[1:-1]
