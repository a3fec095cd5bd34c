"""The plan of a task, found by breadth-first search in the planning domain (`strips.py`), so it is a shortest one.

Shortest plans of the benchmark's tasks and episodes are unique (shown in the tests by counting them), so it does not
matter in which order the search looks at actions.
"""

from __future__ import annotations

from importlib.resources import files

from perdure.home.benchmark.episodes import Episode
from perdure.home.benchmark.plan.problem import plan_problem
from perdure.home.benchmark.plan.strips import read_strips
from perdure.home.benchmark.tasks import HomeTask, SkillStep
from perdure.home.benchmark.tasks.task import with_resets
from perdure.home.errors import HomeError

_NO_SKILL = "next_target"


def make_plan(task: HomeTask | Episode | str) -> tuple[SkillStep, ...]:
    """Return the shortest sequence of skills that solves a task or an episode, `reset_arm` after each.

    The form is that of `HomeTask.skills`.

    Raises:
        HomeError: If the task cannot be solved, or cannot be put as a planning problem (see `plan_problem`).
    """
    problem = plan_problem(task)
    actions = read_strips(domain_pddl(), problem.pddl).shortest_plan()
    if actions is None:
        raise HomeError(
            f"no plan solves {problem.name}: no sequence of its skills ends with {' '.join(problem.final)}; "
            "doors are opened only for a target behind them"
        )
    skills = [(name, int(target.removeprefix("target_"))) for name, target, *_ in actions]
    return with_resets(*(step for step in skills if step[0] != _NO_SKILL))


def domain_pddl() -> str:
    """Return the planning domain as PDDL text: predicates and actions shared by all tasks."""
    return files(__package__).joinpath("domain.pddl").read_text(encoding="utf-8")


def problem_pddl(task: HomeTask | Episode | str) -> str:
    """Return the planning problem of a task or an episode as PDDL text; HomeError as in `plan_problem`."""
    return plan_problem(task).pddl
