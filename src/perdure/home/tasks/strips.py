"""Planning in STRIPS: ground actions from schemas, and a shortest plan by breadth-first search.

This is the `:strips` and `:typing` part of PDDL (McDermott et al., 1998): a fact is true or not, an action needs facts,
adds facts and deletes facts. The benchmark's problems have a few hundred ground actions, so nothing more is needed.
Their shortest plans are unique (the tests count them), so it does not matter in which order the search looks at
actions.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product

Fact = tuple[str, ...]
"""A predicate's name and its arguments. In a schema an argument that begins with "?" is a parameter."""
Facts = frozenset[Fact]
Typed = tuple[tuple[str, str], ...]
"""Pairs of an object or parameter and its type."""


@dataclass(frozen=True)
class ActionSchema:
    """An action with parameters."""

    name: str
    parameters: Typed
    needs: tuple[Fact, ...]
    adds: tuple[Fact, ...]
    deletes: tuple[Fact, ...]


@dataclass(frozen=True)
class Domain:
    """What all planning problems of one kind share."""

    name: str
    types: Mapping[str, str]
    """The parent of each type; "object" has none."""
    constants: Typed
    predicates: Mapping[str, Typed]
    """Parameters of each predicate."""
    actions: tuple[ActionSchema, ...]

    def is_a(self, kind: str, wanted: str) -> bool:
        """Return whether a type is another one, or a subtype of it."""
        while kind != wanted and kind in self.types:
            kind = self.types[kind]
        return kind == wanted


@dataclass(frozen=True)
class Action:
    """A ground action."""

    name: str
    arguments: tuple[str, ...]
    needs: Facts
    adds: Facts
    deletes: Facts


@dataclass(frozen=True)
class GroundProblem:
    """What is true at the start, what must be true at the end, and the actions that there are."""

    start: Facts
    goal: Facts
    actions: tuple[Action, ...]

    def shortest_plan(self) -> list[Action] | None:
        """Return the actions of a shortest plan, None when there is no plan."""
        came_by: dict[Facts, tuple[Facts, Action] | None] = {self.start: None}
        waiting = deque([self.start])
        while waiting:
            known = waiting.popleft()
            if self.goal <= known:
                return _way_to(known, came_by)
            for action in self.actions:
                if not action.needs <= known:
                    continue
                reached = (known - action.deletes) | action.adds
                if reached not in came_by:
                    came_by[reached] = (known, action)
                    waiting.append(reached)
        return None


def _way_to(known: Facts, came_by: Mapping[Facts, tuple[Facts, Action] | None]) -> list[Action]:
    """Return the actions that led from the start to `known`."""
    actions = []
    step = came_by[known]
    while step is not None:
        before, action = step
        actions.append(action)
        step = came_by[before]
    return actions[::-1]


def ground(domain: Domain, objects: Typed, start: Facts, goal: Facts) -> GroundProblem:
    """Return the ground problem of a domain for some objects beside its constants.

    Actions that could never apply are left out: they need a fact that is not true and that no action adds.
    """
    known = (*domain.constants, *objects)
    changing = {fact[0] for schema in domain.actions for fact in (*schema.adds, *schema.deletes)}
    actions = [action for schema in domain.actions for action in _ground_actions(domain, schema, known)]
    possible = [each for each in actions if all(fact[0] in changing or fact in start for fact in each.needs)]
    return GroundProblem(start, goal, tuple(possible))


def _ground_actions(domain: Domain, schema: ActionSchema, objects: Typed) -> Iterator[Action]:
    """Yield an action for every choice of objects of the right types."""
    fitting = [[name for name, kind in objects if domain.is_a(kind, wanted)] for _, wanted in schema.parameters]
    for chosen in product(*fitting):
        bound = {parameter: name for (parameter, _), name in zip(schema.parameters, chosen, strict=True)}
        yield Action(
            schema.name,
            chosen,
            needs=_bind(schema.needs, bound),
            adds=_bind(schema.adds, bound),
            deletes=_bind(schema.deletes, bound),
        )


def _bind(facts: tuple[Fact, ...], bound: Mapping[str, str]) -> Facts:
    return frozenset(tuple(bound.get(word, word) for word in fact) for fact in facts)


def fact_text(fact: Fact) -> str:
    """Return a fact as PDDL writes it, such as `(at_goal target_0)`."""
    return f"({' '.join(fact)})"
