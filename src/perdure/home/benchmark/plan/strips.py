"""Plain STRIPS: reads PDDL with types and constants, grounds the actions, finds a shortest plan breadth-first.

Fikes and Nilsson (1971); PDDL's `:strips` and `:typing` (McDermott et al., 1998). The benchmark's problems have a few
hundred ground actions, so nothing more is needed.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

from perdure.home.errors import HomeError

Fact = tuple[str, ...]
"""A predicate's name and its arguments; also an action's name and arguments."""
State = frozenset[Fact]


@dataclass(frozen=True)
class Action:
    """A ground action."""

    name: Fact
    needs: State
    adds: State
    deletes: State


@dataclass(frozen=True)
class Strips:
    """A ground planning problem."""

    start: State
    goal: State
    actions: tuple[Action, ...]

    def shortest_plan(self) -> list[Fact] | None:
        """Return the names of the actions of a shortest plan, None when there is no plan."""
        came: dict[State, tuple[State, Fact] | None] = {self.start: None}
        waiting = deque([self.start])
        while waiting:
            state = waiting.popleft()
            if self.goal <= state:
                return _way_to(state, came)
            for action in self.actions:
                if action.needs <= state:
                    reached = (state - action.deletes) | action.adds
                    if reached not in came:
                        came[reached] = state, action.name
                        waiting.append(reached)
        return None


def read_strips(domain: str, problem: str) -> Strips:
    """Return the ground problem that a domain and a problem in PDDL describe.

    Raises:
        HomeError: Parentheses do not match, or a condition is more than a conjunction of facts.
    """
    rules, task = _parse(domain), _parse(problem)
    parents = dict(_typed(_section(rules, ":types")))
    objects = [*_typed(_section(rules, ":constants")), *_typed(_section(task, ":objects"))]
    start = frozenset(tuple(fact) for fact in _section(task, ":init"))
    schemas = [(part[1], dict(zip(part[2::2], part[3::2], strict=True))) for part in rules if part[0] == ":action"]
    changing = {fact[0] for _, parts in schemas for side in _split(parts[":effect"]) for fact in side}
    actions = [action for name, parts in schemas for action in _ground(name, parts, objects, parents)]
    possible = [each for each in actions if all(fact[0] in changing or fact in start for fact in each.needs)]
    return Strips(start, frozenset(_positive(_section(task, ":goal")[0])), tuple(possible))


def _ground(
    name: str, parts: dict[str, Any], objects: Sequence[tuple[str, str]], parents: dict[str, str]
) -> Iterator[Action]:
    """Yield an action for every choice of objects of the right types."""
    parameters = list(_typed(parts[":parameters"]))
    fitting = [[each for each, kind in objects if _is_a(kind, wanted, parents)] for _, wanted in parameters]
    needs, (adds, deletes) = _positive(parts[":precondition"]), _split(parts[":effect"])
    for chosen in product(*fitting):
        bound = {variable: each for (variable, _), each in zip(parameters, chosen, strict=True)}
        yield Action((name, *chosen), *(_bind(facts, bound) for facts in (needs, adds, deletes)))


def _bind(facts: Sequence[Fact], bound: dict[str, str]) -> State:
    return frozenset(tuple(bound.get(word, word) for word in fact) for fact in facts)


def _parse(text: str) -> list[Any]:
    """Return the parts of (define ...) as nested lists of words."""
    stack: list[list[Any]] = [[]]
    for word in re.findall(r"[()]|[^\s()]+", re.sub(r";[^\n]*", "", text)):
        if word == "(":
            stack.append([])
        elif word == ")" and len(stack) > 1:
            inner = stack.pop()
            stack[-1].append(inner)
        else:
            stack[-1].append(word)
    if len(stack) != 1 or len(stack[0]) != 1 or stack[0][0][:1] != ["define"]:
        raise HomeError("PDDL must be one (define ...) with matching parentheses")
    return list(stack[0][0][1:])


def _section(parts: list[Any], name: str) -> list[Any]:
    return next((part[1:] for part in parts if part[0] == name), [])


def _typed(words: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield (name, type) of "a b - kind c - other"."""
    names: list[str] = []
    rest = iter(words)
    for word in rest:
        if word == "-":
            kind = next(rest)
            yield from ((name, kind) for name in names)
            names = []
        else:
            names.append(word)


def _is_a(kind: str, wanted: str, parents: dict[str, str]) -> bool:
    return kind == wanted or (kind in parents and _is_a(parents[kind], wanted, parents))


def _positive(condition: list[Any]) -> list[Fact]:
    facts, negated = _split(condition)
    if negated:
        raise HomeError(f"plain STRIPS has no negative conditions, such as {negated[0]}")
    return facts


def _split(condition: list[Any]) -> tuple[list[Fact], list[Fact]]:
    """Return the facts of a conjunction, and those it negates."""
    literals = condition[1:] if condition[0] == "and" else [condition]
    facts = [tuple(each) for each in literals if each[0] != "not"]
    return facts, [tuple(each[1]) for each in literals if each[0] == "not"]


def _way_to(state: State, came: dict[State, tuple[State, Fact] | None]) -> list[Fact]:
    names = []
    while (step := came[state]) is not None:
        state, name = step
        names.append(name)
    return names[::-1]
