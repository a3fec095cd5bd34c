"""``perdure home plan``."""

from __future__ import annotations

from dataclasses import dataclass

import tyro

from perdure.cli.home.flags import parse_home


@dataclass(frozen=True)
class HomePlan:
    """Show a task's plan as a STRIPS planner finds it."""

    task: tyro.conf.Positional[str]
    """tidy_house, prepare_groceries or set_table."""


def main(args: list[str]) -> None:
    """Run ``perdure home plan``."""
    flags = parse_home(HomePlan, args, "plan")
    from perdure.home.skills import SKILLS, get_skill
    from perdure.home.tasks.planning import print_plan

    print_plan(flags.task, {name: get_skill(name).limit for name in SKILLS})
