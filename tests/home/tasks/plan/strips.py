"""A STRIPS interpreter of a few lines, for checking plans: it knows nothing of perdure or of pyperplan."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import product

Fact = tuple[str, ...]


@dataclass(frozen=True)
class Action:
    """A ground action."""

    name: Fact
    needs: frozenset[Fact]
    adds: frozenset[Fact]
    deletes: frozenset[Fact]


@dataclass(frozen=True)
class World:
    """A ground problem."""

    start: frozenset[Fact]
    goal: frozenset[Fact]
    actions: dict[Fact, Action]

    def after(self, names, state=None):
        """The state after a sequence of actions, None when one of them does not apply."""
        state = self.start if state is None else state
        for name in names:
            action = self.actions.get(name)
            if action is None or not action.needs <= state:
                return None
            state = (state - action.deletes) | action.adds
        return state


def parse(domain, problem):
    """Reads PDDL with unified-planning's reader and grounds it."""
    from unified_planning.io import PDDLReader

    question = PDDLReader().parse_problem_string(domain, problem)
    start = frozenset(_fact(f, {}) for f, value in question.initial_values.items() if value.is_true())
    goal = frozenset(_fact(f, {}) for f in _conjuncts(question.goals))
    changing = {e.fluent.fluent().name for action in question.actions for e in action.effects}
    actions = {}
    for schema in question.actions:
        for objects in product(*(list(question.objects(p.type)) for p in schema.parameters)):
            bound = {p.name: o.name for p, o in zip(schema.parameters, objects, strict=True)}
            needs = frozenset(_fact(f, bound) for f in _conjuncts(schema.preconditions))
            if any(fact[0] not in changing and fact not in start for fact in needs):
                continue  # what no action changes and is not true now never will be
            adds = frozenset(_fact(e.fluent, bound) for e in schema.effects if e.value.is_true())
            deletes = frozenset(_fact(e.fluent, bound) for e in schema.effects if e.value.is_false())
            name = (schema.name, *bound.values())
            actions[name] = Action(name, needs, adds, deletes)
    return World(start, goal, actions)


def shortest_plans(world, longest=60):
    """Length and number of all shortest plans, and one of them: all paths through the state space, layer by layer."""
    layer, seen, way = Counter({world.start: 1}), {world.start}, {world.start: ()}
    for length in range(longest):
        done = [state for state in layer if world.goal <= state]
        if done:
            return length, sum(layer[state] for state in done), way[done[0]]
        following = Counter()
        for state, paths in layer.items():
            for action in world.actions.values():
                if action.needs <= state:
                    reached = (state - action.deletes) | action.adds
                    if reached not in seen:
                        following[reached] += paths
                        way.setdefault(reached, (*way[state], action.name))
        seen |= set(following)
        layer = following
    return None, 0, ()


def _fact(expression, bound):
    arguments = (a.parameter().name if a.is_parameter_exp() else a.object().name for a in expression.args)
    return (expression.fluent().name, *(bound.get(name, name) for name in arguments))


def _conjuncts(expressions):
    for expression in expressions:
        if expression.is_and():
            yield from _conjuncts(expression.args)
        else:
            assert expression.is_fluent_exp(), f"not plain STRIPS: {expression}"
            yield expression
