"""``perdure home``: the Home Assistant Benchmark; one file for each of its commands."""

from __future__ import annotations

import sys
from importlib import import_module

from perdure.errors import did_you_mean

USAGE = """perdure home: the Home Assistant Benchmark on MuJoCo.

  perdure home list                          tasks, episodes, skills, objects
  perdure home episode TASK --index 3        starts and goals of an episode; with --render out.png a picture
  perdure home plan TASK                     the task plan, found by a STRIPS planner
  perdure home video TASK --index 3          a film of the oracle; with --place of release strategies side by side
  perdure home view TASK --index 3           the oracle live in a browser
  perdure home train SKILL                   train a skill
  perdure home run TASK --place ik           the protocol: episodes x training seeds x evaluation seeds
  perdure home analyze LOGS --out PAGE       success per stage, failure causes, placements; with --out as a page
  perdure home failures LOGS                 failed episodes, drawn at random, in pictures: is the label right?
  perdure home overlaps LOGS                 objects at rest that lie inside each other: is the simulation sound?

Each command explains its options with --help.
"""

COMMANDS = ("list", "episode", "plan", "video", "view", "train", "run", "analyze", "failures", "overlaps")
"""Each is a module of this package; it is imported only when the command is given."""
ALIASES = {"analyse": "analyze"}


def main(args: list[str]) -> None:
    """Run ``perdure home``."""
    if not args or args[0] in ("-h", "--help"):
        print(USAGE, end="")
        return
    command = ALIASES.get(args[0], args[0])
    if command in COMMANDS:
        import_module(f"perdure.cli.home.{command}").main(args[1:])
        return
    hint = did_you_mean(command, COMMANDS) or f"; the commands are {', '.join(COMMANDS)}"
    print(f"perdure: unknown command home {args[0]!r}{hint}", file=sys.stderr)
    raise SystemExit(2)
