"""PDDL text of the planning domain and of problems, for people and for other planners. Nothing here reads it."""

from __future__ import annotations

import re
from collections.abc import Sequence

from perdure.home.tasks.planning import PlanProblem
from perdure.home.tasks.strips import ActionSchema, Domain, Typed, fact_text


def domain_pddl(domain: Domain) -> str:
    """Return a planning domain as PDDL text."""
    types = [f"{kind} - {parent}" for kind, parent in domain.types.items()]
    predicates = [f"({' '.join([name, *_typed(parameters)])})" for name, parameters in domain.predicates.items()]
    sections = [
        _section("types", types),
        _section("constants", _typed(domain.constants)),
        _section("predicates", predicates),
        *(_action(schema) for schema in domain.actions),
    ]
    return f"(define (domain {domain.name})\n  (:requirements :strips :typing)\n{''.join(sections)})\n"


def problem_pddl(problem: PlanProblem) -> str:
    """Return a planning problem as PDDL text."""
    name = re.sub(r"\W", "_", f"plan {problem.name}", flags=re.ASCII)
    sections = [
        _section("objects", _typed(problem.objects)),
        _section("init", [fact_text(fact) for fact in problem.start]),
        _section("goal (and", [*(fact_text(fact) for fact in problem.final), ")"]),
    ]
    return f"(define (problem {name})\n  (:domain home)\n{''.join(sections)})\n"


def _section(title: str, rows: Sequence[str]) -> str:
    return "\n    ".join([f"  (:{title}", *rows]) + ")\n"


def _typed(names: Typed) -> list[str]:
    return [f"{name} - {kind}" for name, kind in names]


def _action(schema: ActionSchema) -> str:
    needs = " ".join(fact_text(fact) for fact in schema.needs)
    deletes = [f"(not {fact_text(fact)})" for fact in schema.deletes]
    effects = " ".join([*deletes, *(fact_text(fact) for fact in schema.adds)])
    return (
        f"  (:action {schema.name}\n"
        f"    :parameters ({' '.join(_typed(schema.parameters))})\n"
        f"    :precondition (and {needs})\n"
        f"    :effect (and {effects}))\n"
    )
