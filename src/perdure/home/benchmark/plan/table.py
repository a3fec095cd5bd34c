"""A plan as a table for a terminal."""

from __future__ import annotations

from perdure.home.benchmark.episodes import Episode
from perdure.home.benchmark.plan.planner import make_plan
from perdure.home.benchmark.plan.problem import Container, plan_problem
from perdure.home.benchmark.tasks import HomeTask, SkillStep


def render_plan(plan: tuple[SkillStep, ...], task: HomeTask | Episode | str | None = None) -> str:
    """Return a plan as a table: number, skill, target, where it happens, limit in control steps.

    Args:
        plan: The steps.
        task: What it is the plan of. When given, the table names the containers, of an episode the very drawer.
    """
    starts: tuple[Container | None, ...] = () if task is None else plan_problem(task).starts
    rows = [["", "skill", "target", "where", "limit"]]
    for number, step in enumerate(plan, 1):
        rows.append([str(number), step.skill, str(step.target), _where(step, starts), str(step.limit)])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    rows.insert(1, ["-" * width for width in widths])
    columns = list(zip("><><>", widths, strict=True))  # numbers to the right, words to the left
    return "\n".join(
        "  ".join(f"{cell:{side}{width}}" for cell, (side, width) in zip(row, columns, strict=True)) for row in rows
    )


def print_plan(task: HomeTask | Episode | str) -> None:
    """Print the plan of a task or an episode as a table, with a line on what it is and how long it may last."""
    plan = make_plan(task)
    limits = sum(step.limit for step in plan)
    print(f"{plan_problem(task).name}: {len(plan)} steps, their limits together {limits}\n")
    print(render_plan(plan, task))


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
