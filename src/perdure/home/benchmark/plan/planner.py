"""The plan of a task, found by a planner: pyperplan, asked through unified-planning.

The search is breadth-first, so the plan is a shortest one. Shortest plans of the benchmark's tasks and episodes are
unique (shown in the tests by counting them), so it does not matter in which order the planner looks at actions.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.resources import files
from typing import Any

from perdure.home.benchmark.episodes import Episode
from perdure.home.benchmark.plan.problem import PlanProblem, plan_problem
from perdure.home.benchmark.tasks import HomeTask, SkillStep
from perdure.home.benchmark.tasks.task import with_resets
from perdure.home.errors import HomeError

_NO_SKILL = "next_target"


def make_plan(task: HomeTask | Episode | str) -> tuple[SkillStep, ...]:
    """Return the shortest sequence of skills that solves a task, `reset_arm` after each.

    Args:
        task: A task, the name of one, or an episode.

    Returns:
        The steps, in the form of `HomeTask.skills`.

    Raises:
        HomeError: If the task cannot be solved, cannot be put as a planning problem (see `plan_problem`), or the
            planner is not installed.
    """
    problem = plan_problem(task)
    actions = _search(problem)
    if actions is None:
        raise HomeError(
            f"no plan solves {problem.name}: no sequence of its skills ends with {' '.join(problem.final)}; "
            "doors are opened only for a target behind them"
        )
    skills = [(name, int(target.removeprefix("target_"))) for name, target in actions]
    return with_resets(*(step for step in skills if step[0] != _NO_SKILL))


def domain_pddl() -> str:
    """Return the planning domain as PDDL text: predicates and actions shared by all tasks."""
    return files(__package__).joinpath("domain.pddl").read_text(encoding="utf-8")


def problem_pddl(task: HomeTask | Episode | str) -> str:
    """Return the planning problem of a task or an episode as PDDL text; HomeError as in `plan_problem`."""
    return plan_problem(task).pddl


def _search(problem: PlanProblem) -> list[tuple[str, str]] | None:
    """Return name and first argument of each action of a shortest plan, None when there is no plan."""
    planning = _planning()
    environment = planning["environment"].Environment()
    environment.credits_stream = None  # it would print the planner's credits on every use
    question = planning["io"].PDDLReader(environment).parse_problem_string(domain_pddl(), problem.pddl)
    with _root_logger_kept(), environment.factory.OneshotPlanner(name="pyperplan", params={"search": "bfs"}) as planner:
        plan = planner.solve(question).plan
    if plan is None:
        return None
    return [(step.action.name, str(step.actual_parameters[0])) for step in plan.actions]


def _planning() -> dict[str, Any]:
    """Return the modules of unified-planning that are used; HomeError when it or pyperplan is not installed."""
    try:
        import_module("up_pyperplan")
        return {name: import_module(f"unified_planning.{name}") for name in ("environment", "io")}
    except ImportError:
        raise HomeError("plans need unified-planning and up-pyperplan: pip install 'perdure[home]'") from None


@contextmanager
def _root_logger_kept() -> Iterator[None]:
    """Pyperplan's log messages would give the root logger a handler, and an application could no longer set its own."""
    root = logging.getLogger()
    handlers = root.handlers[:]
    try:
        yield
    finally:
        root.handlers[:] = handlers
