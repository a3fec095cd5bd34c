"""The benchmark's task planner: which skills, in which order, found by a STRIPS planner instead of written down.

Contents:
    make_plan                       the shortest plan of a task or an episode, in the form of `HomeTask.skills`
    render_plan, print_plan         a plan as a table
    domain_pddl, problem_pddl       what the planner is asked, as PDDL text (`domain.pddl`)
    plan_problem, PlanProblem       the problem as data: containers, what is open, what must hold in the end
    Container
    read_strips, Strips             a STRIPS problem read from PDDL, and its shortest plan
"""

from perdure.home.benchmark.plan.planner import domain_pddl, make_plan, problem_pddl
from perdure.home.benchmark.plan.problem import Container, PlanProblem, plan_problem
from perdure.home.benchmark.plan.strips import Strips, read_strips
from perdure.home.benchmark.plan.table import print_plan, render_plan

__all__ = [
    "Container",
    "PlanProblem",
    "Strips",
    "domain_pddl",
    "make_plan",
    "plan_problem",
    "print_plan",
    "problem_pddl",
    "read_strips",
    "render_plan",
]
