"""Command line: one module for each command, with its flags as a dataclass and no other logic."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module

USAGE = """perdure: train a policy in finite episodes, deploy it without end, and know beforehand whether it holds.

  perdure train TASK --method geometric      train with time-to-go (or plain PPO, or a control)
  perdure extrapolate POLICY...              run policies far beyond their training horizon, and report
  perdure import MODEL.zip --env ID          convert a Stable-Baselines3 model to a policy file
  perdure export POLICY policy.onnx          export a policy as an ONNX model
  perdure report TABLE                       write the report of an evaluation again
  perdure watch POLICY --until-failure       film a policy as it fails
  perdure card POLICY --table TABLE          write a policy's model card
  perdure list tasks|methods|policies        list tasks, training methods or shipped policies
  perdure inspect POLICY                     show what a policy file contains
  perdure study NAME                         run or resume a study of many training runs
  perdure home ...                           the Home Assistant Benchmark: does the object stay where it was put?

Each command explains its options with --help.
"""

COMMANDS = {
    "train": "train",
    "extrapolate": "extrapolate",
    "import": "importing",
    "export": "export",
    "report": "report",
    "watch": "watch",
    "card": "card",
    "list": "listing",
    "inspect": "inspect",
    "study": "study",
    "home": "home",
}
"""Command to its module in this package, which is imported only when the command is used."""

RESUMING = ("train", "extrapolate", "study", "home train", "home run")
"""Commands that keep finished parts of an interrupted run."""


def resumes(args: Sequence[str]) -> bool:
    """Return whether the same command line continues after an interruption; an evaluated ONNX model starts again."""
    name = " ".join(args[: 2 if args and args[0] == "home" else 1])
    if name != "extrapolate":
        return name in RESUMING
    from perdure.policy.onnx import is_onnx

    return not any(map(is_onnx, args))


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
        import_module(f"perdure.cli.{COMMANDS[args[0]]}").main(list(args[1:]))
    else:
        print(f"perdure: unknown command {args[0]!r}; the commands are {', '.join(COMMANDS)}", file=sys.stderr)
        raise SystemExit(2)
