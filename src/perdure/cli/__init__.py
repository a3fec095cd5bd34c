"""Command line: each command is a function whose signature and docstring are its flags and its help."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module

DOCS = "https://github.com/perdure/perdure/blob/main/docs/index.md"
USAGE = f"""perdure: train a policy in finite episodes, deploy it without end, and know beforehand whether it holds.

  perdure train Hopper-v3 --method geometric           train with time-to-go (or plain PPO, or a control)
  perdure extrapolate Hopper-v3/geometric              run policies far beyond their training horizon, and report
  perdure import model.zip --env Hopper-v5             convert a Stable-Baselines3 model to a policy file
  perdure export Hopper-v3/geometric policy.onnx       export a policy as an ONNX model
  perdure report extrapolation                         write the report of an evaluation again
  perdure watch Hopper-v3/ppo --until-failure          film a policy as it fails
  perdure card my-policy --table extrapolation         write a policy's model card
  perdure list policies                                list tasks, training methods or shipped policies
  perdure inspect Hopper-v3/geometric                  show what a policy file contains
  perdure home ...                                     the Home Assistant Benchmark: does the object stay?

Each command explains its options with --help. Documentation: {DOCS}
"""

COMMANDS = {
    **dict.fromkeys(("train", "extrapolate", "import", "export"), "commands"),
    **{"report": "report", "watch": "watch"},
    **dict.fromkeys(("card", "list", "inspect"), "commands"),
    "home": "home",
}
"""Command to its module in this package, which is imported only when the command is used."""

RESUMING = ("train", "extrapolate", "home train", "home run")
"""Commands that keep finished parts of an interrupted run."""


def resumes(args: Sequence[str]) -> bool:
    """Return whether the same command line continues after an interruption."""
    return " ".join(args[: 2 if args and args[0] == "home" else 1]) in RESUMING


def example(command: str) -> str:
    """Return a command line that shows a command, such as "home run"; empty where there is none."""
    usage = import_module("perdure.cli.home").USAGE if command.startswith("home ") else USAGE
    lines = (line.strip().partition("  ")[0] for line in usage.splitlines())
    return next((line for line in lines if f"{line} ".startswith(f"perdure {command} ")), "")


def run(args: Sequence[str]) -> None:
    """Run one command line, given without the program's name.

    Raises:
        SystemExit: For --help, and with code 2 for flags that cannot be read.
    """
    if not args or args[0] in ("-h", "--help"):
        print(USAGE, end="")
    elif args[0] == "--version":
        from importlib.metadata import version

        print(f"perdure {version('perdure')}")
    elif args[0] in COMMANDS:
        name, rest = COMMANDS[args[0]], list(args[1:])
        module = import_module(f"perdure.cli.{name}")
        module.run(args[0], rest) if name == "commands" else module.main(rest)
    else:
        print(f"perdure: unknown command {args[0]!r}; the commands are {', '.join(COMMANDS)}", file=sys.stderr)
        raise SystemExit(2)
