"""A plan as a table for a terminal."""

from __future__ import annotations

from collections.abc import Mapping

from perdure.home.benchmark.episodes import Episode
from perdure.home.benchmark.plan.planner import make_plan
from perdure.home.benchmark.plan.problem import Container, plan_problem
from perdure.home.benchmark.tasks import HomeTask, SkillStep


def render_plan(
    plan: tuple[SkillStep, ...], task: HomeTask | Episode | str | None = None, limits: Mapping[str, int] | None = None
) -> str:
    """Return a plan as a table: number, skill, target, where it happens, step limit.

    Args:
        plan: The steps.
        task: The task or episode of the plan, for the names of containers; an episode determines the drawer, too.
        limits: Step limit by skill. Without it there is no such column.
    """
    starts: tuple[Container | None, ...] = () if task is None else plan_problem(task).starts
    rows = [["", "skill", "target", "where", *(["limit"] if limits else [])]]
    for number, step in enumerate(plan, 1):
        limit = [str(limits[step.skill])] if limits else []
        rows.append([str(number), step.skill, str(step.target), _where(step, starts), *limit])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    rows.insert(1, ["-" * width for width in widths])
    columns = list(zip("><><>", widths, strict=False))  # numbers to the right, words to the left
    return "\n".join(
        "  ".join(f"{cell:{side}{width}}" for cell, (side, width) in zip(row, columns, strict=True)) for row in rows
    )


def print_plan(task: HomeTask | Episode | str, limits: Mapping[str, int] | None = None) -> None:
    """Print the plan of a task or an episode as a table; arguments as of `render_plan`."""
    plan = make_plan(task)
    total = f", their limits together {sum(limits[step.skill] for step in plan)}" if limits else ""
    print(f"{plan_problem(task).name}: {len(plan)} steps{total}\n")
    print(render_plan(plan, task, limits))


def _where(step: SkillStep, starts: tuple[Container | None, ...]) -> str:
    """Return the place of a step, for `navigate` its destination."""
    if step.skill == "reset_arm":
        return ""
    skill = step.toward or step.skill
    container = starts[step.target] if step.target < len(starts) else None
    if skill == "place":
        where = f"goal of target {step.target}"
    elif skill == "pick":
        where = f"target {step.target}" + (f" in {_name(container)}" if container else "")
    else:
        kind = skill.partition("_")[2]
        where = f"handle of {_name(container) if container and container.kind == kind else f'the {kind}'}"
    return f"to {where}" if step.skill == "navigate" else where


def _name(container: Container) -> str:
    exact = container.kind == "drawer" and not container.name.startswith("some_")
    return container.name if exact else f"the {container.kind}"
