"""``perdure home``: the Home Assistant Benchmark; one file for each of its commands."""

from __future__ import annotations

import sys
from importlib import import_module

USAGE = """perdure home: the Home Assistant Benchmark on MuJoCo.

  perdure home list                          tasks, episodes, skills, objects
  perdure home episode TASK --index 3        what lies where; with --render out.png a picture
  perdure home plan TASK                     the task plan, found by a STRIPS planner
  perdure home video TASK --index 3          a film of the oracle, or with --place rl ik of placing arms side by side
  perdure home view TASK --index 3           the same, live in a browser
  perdure home train SKILL                   learn a skill
  perdure home run TASK --place ik           the protocol: episodes x training seeds x evaluation seeds
  perdure home analyze LOGS --out PAGE       stages, failure modes, what stayed; with --out as a page
  perdure home failures LOGS                 failed episodes, drawn at random, in pictures: is the label right?
  perdure home overlaps LOGS                 objects at rest that lie inside each other: is the world sound?

Each command explains its options with --help.
"""

COMMANDS = {
    "list": "home_list",
    "episode": "home_episode",
    "plan": "home_plan",
    "video": "home_video",
    "view": "home_view",
    "train": "home_train",
    "run": "home_run",
    "analyze": "home_analyze",
    "failures": "home_failures",
    "overlaps": "home_overlaps",
}
"""Command to the module of this package that carries it out; loaded only when it is asked for."""


def main(args: list[str]) -> None:
    """``perdure home``."""
    if not args or args[0] in ("-h", "--help"):
        print(USAGE, end="")
    elif args[0] in COMMANDS:
        import_module(f"perdure.cli.{COMMANDS[args[0]]}").main(args[1:])
    else:
        print(f"perdure: unknown command home {args[0]!r}; the commands are {', '.join(COMMANDS)}", file=sys.stderr)
        raise SystemExit(2)
