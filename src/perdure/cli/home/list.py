"""``perdure home list``."""

from __future__ import annotations

import sys
from dataclasses import dataclass

from perdure.cli.home.flags import parse_home


@dataclass(frozen=True)
class HomeList:
    """Show the tasks, their published episodes, the skills and the objects."""


def main(args: list[str]) -> None:
    """``perdure home list``."""
    parse_home(HomeList, args, "list")
    from rich.console import Console
    from rich.table import Table

    from perdure.home.sim.objects import KINDS
    from perdure.home.skills import SKILLS
    from perdure.home.tasks.episodes import load_episodes
    from perdure.home.tasks.tasks import TASKS

    console = Console()
    tasks = Table("task", "targets", "objects", "val", "eval", "steps", "stages", title="Tasks")
    for task in TASKS.values():
        counts = [str(len(load_episodes(task.name, split))) for split in ("val", "eval")]
        objects = len(task.targets) + sum(number for number, _ in task.clutter)
        stages = " ".join(stage.name for stage in task.stages)
        tasks.add_row(task.name, str(len(task.targets)), str(objects), *counts, str(task.max_steps), stages)
    skills = Table("skill", "steps", "observation size", "description", title="Skills")
    for name, kind in SKILLS.items():
        skills.add_row(name, str(kind().limit), str(len(kind().elements)), _description(kind))
    kinds = Table("object", "size [mm]", "mass [g]", "shape", title="Objects")
    for each in KINDS.values():
        size = " x ".join(f"{1000 * side:.0f}" for side in each.size)
        kinds.add_row(each.name, size, f"{1000 * each.mass:.0f}", each.shape)
    for table in (tasks, skills, kinds):
        for column in table.columns[:-1]:
            column.no_wrap = True
        console.print(table)


def _description(kind: type) -> str:
    """Return the first words of the module that a skill is in."""
    return (sys.modules[kind.__module__].__doc__ or "").split(":")[0]
