"""Plans: a planning problem in PDDL, and a shortest plan by breadth-first search.

The search reads the `:strips` and `:typing` part of PDDL (McDermott et al., 1998). The benchmark's problems have a few
hundred ground actions, so nothing more is needed. Their shortest plans are unique (the tests count them), so it does
not matter in which order the search looks at actions.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib.resources import files
from itertools import pairwise, product
from typing import Any, Literal

from perdure.errors import PerdureError
from perdure.home.sim.apartments import make_apartment
from perdure.home.sim.objects import Placement
from perdure.home.sim.pieces import FRIDGE_DOOR, Apartment
from perdure.home.tasks.episodes import Episode
from perdure.home.tasks.tasks import (
    DRAWER_CLOSED,
    DRAWER_OPEN,
    FRIDGE_CLOSED,
    FRIDGE_OPENED,
    NOTHING,
    SOMETHING_ELSE,
    HomeTask,
    SkillStep,
    get_task,
    with_resets,
)


@lru_cache(maxsize=256)
def make_plan(task: HomeTask | Episode | str) -> tuple[SkillStep, ...]:
    """Return the shortest sequence of skills that solves a task or an episode, `reset_arm` after each.

    Raises:
        PerdureError: If the task cannot be solved, or cannot be put as a planning problem (see `plan_problem`).
    """
    home_task = get_task(task) if isinstance(task, str) else task.home_task if isinstance(task, Episode) else task
    if home_task.sequence:
        return home_task.sequence
    problem = plan_problem(task)
    if (actions := solve(problem)) is None:
        raise PerdureError(f"no plan solves {problem.name}: no sequence of skills ends with {' '.join(problem.final)}")
    return with_resets(*((action.skill, action.target) for action in actions))


@lru_cache(maxsize=4096)
def solve(problem: PlanProblem) -> tuple[Action, ...] | None:
    """Return the skills of a shortest plan, None when there is no plan."""
    actions = read_strips(domain_pddl(), problem.pddl).shortest_plan()
    return None if actions is None else tuple(each for each in actions if each.skill != "next_target")


@cache
def domain_pddl() -> str:
    """Return the planning domain as PDDL text: predicates and actions shared by all tasks."""
    return files(__package__).joinpath("domain.pddl").read_text(encoding="utf-8")


Kind = Literal["drawer", "fridge"]
SWITCHES: dict[Kind, tuple[float, float]] = {
    "drawer": (DRAWER_CLOSED, DRAWER_OPEN),
    "fridge": (FRIDGE_CLOSED, FRIDGE_OPENED),
}
"""Closed up to the first joint position, open from the second one on."""
_SOME_DRAWER = "some_drawer"


@dataclass(frozen=True)
class Container:
    """A drawer or the fridge."""

    name: str
    """Its link, such as `drawer2_top`; `some_drawer` where only an episode says which one."""
    kind: Kind
    is_open: bool


@dataclass(frozen=True)
class PlanProblem:
    """One planning problem; `None` instead of a container means in the open."""

    name: str
    starts: tuple[Container | None, ...]
    """Container of each target at the start."""
    ends: tuple[Container | None, ...]
    """Container of each target's goal."""
    final: tuple[str, ...]
    """The goal, as facts of the domain."""
    inside: tuple[Container | None, ...]
    """Container of each target now."""
    placed: frozenset[int] = frozenset()
    """Targets at their goals."""
    held: int = NOTHING
    """Number of the target in the hand, NOTHING or SOMETHING_ELSE. Its turn is the first."""
    robot_at: str = "elsewhere"
    """The landmark where the robot stands; `elsewhere` for none."""

    @property
    def containers(self) -> tuple[Container, ...]:
        """All containers, each once, in the order in which the targets need them."""
        pairs = zip(self.starts, self.ends, strict=True)
        return tuple(dict.fromkeys(c for pair in pairs for c in pair if c is not None))

    @property
    def pddl(self) -> str:
        """The problem as PDDL text."""
        count = len(self.starts)
        order = sorted(range(count), key=lambda i: i != self.held)
        hand = {NOTHING: ["(hand_empty)"], SOMETHING_ELSE: []}.get(self.held, [f"(holding target_{self.held})"])
        objects = [f"target_{i} - target goal_{i} - goal" for i in range(count)]
        objects += [f"{c.name} - {c.kind}" for c in self.containers]
        facts = [f"(robot_at {self.robot_at})", *hand, "(open in_the_open)", f"(turn target_{order[0]})"]
        facts += [f"(next target_{i} target_{k})" for i, k in pairwise(order)]
        facts += [f"(at_goal target_{i})" for i in sorted(self.placed)]
        facts += [f"({'open' if c.is_open else 'closed'} {c.name})" for c in self.containers]
        for i, (start, end) in enumerate(zip(self.starts, self.ends, strict=True)):
            inside, where = ("in_the_open" if each is None else each.name for each in (self.inside[i], end))
            facts += [f"(in target_{i} {inside})"] if i != self.held else []
            facts.append(f"(goal_of goal_{i} target_{i} {where})")
            landmarks = [f"target_{i}", f"goal_{i}", *dict.fromkeys(c.name for c in (start, end) if c is not None)]
            facts += [f"(concerns {landmark} target_{i})" for landmark in landmarks]
        name = re.sub(r"\W", "_", f"plan {self.name}", flags=re.ASCII)
        sections = [("objects", objects), ("init", facts), ("goal (and", [*self.final, ")"])]
        body = "".join("\n    ".join([f"  (:{title}", *rows]) + ")\n" for title, rows in sections)
        return f"(define (problem {name})\n  (:domain home)\n{body})\n"


def plan_problem(task: HomeTask | Episode | str) -> PlanProblem:
    """Return the planning problem of a task or an episode; an episode also says which drawer it is.

    Raises:
        PerdureError: For an unknown task, one without targets, a door that is neither open nor closed at the start, a
            target that may lie in containers of different kinds, or a condition about a container no target is in.
    """
    if isinstance(task, Episode):
        home_task, opened, name = task.home_task, task.opened, task.name
        starts, ends = _receptacles(task.objects[: len(task.goals)]), _receptacles(task.goals)
    else:
        home_task = get_task(task) if isinstance(task, str) else task
        opened, name = home_task.opened, home_task.name
        starts = [rule.start.receptacles for rule in home_task.targets]
        ends = [rule.goal.receptacles for rule in home_task.targets]
    if not starts:
        raise PerdureError(f"{name} has no targets: there is nothing to plan")
    apartment = make_apartment(0, 0)  # any one: counter and fridge have the same drawers, door and names in all
    inside = [tuple(_container(apartment, names, opened, name) for names in side) for side in (starts, ends)]
    if sum(container is not None and container.name == _SOME_DRAWER for side in inside for container in side) > 1:
        raise PerdureError(f"several targets of {name} are in one drawer or another: ask for the plan of an episode")
    return PlanProblem(name, inside[0], inside[1], _final(home_task, (*inside[0], *inside[1])), inside[0])


def _receptacles(placements: Iterable[Placement]) -> list[tuple[str, ...]]:
    """Return the receptacle of each placement, by the benchmark's name."""
    return [(placement.receptacle.split("|")[-1],) for placement in placements]


def _container(
    apartment: Apartment, receptacles: Iterable[str], opened: Mapping[str, float], name: str
) -> Container | None:
    """Return the container that must be opened to reach any of these receptacles."""
    found = {apartment.container(apartment.receptacles_named(each)[0].unique_name) for each in receptacles}
    links = sorted(link or "" for link in found)
    kinds = {_kind(link) for link in found}
    states = {_is_open(link, opened.get(link, 0.0), name) for link in found if link}
    if len(kinds) != 1 or len(states) > 1:
        raise PerdureError(
            f"{name} leaves open what a target is in ({', '.join(link or 'in the open' for link in links)}) "
            "and the plans differ: ask for the plan of an episode"
        )
    (kind,) = kinds
    if kind is None:
        return None
    return Container(links[0] if len(links) == 1 else _SOME_DRAWER, kind, states == {True})


def _kind(link: str | None) -> Kind | None:
    return None if link is None else "fridge" if link == FRIDGE_DOOR else "drawer"


def _is_open(link: str, position: float, name: str) -> bool:
    closed, opened = SWITCHES[_kind(link) or "drawer"]
    if closed < position < opened:
        raise PerdureError(
            f"{link} of {name} stands at {position:g}, neither closed (up to {closed:g}) nor open (from {opened:g} "
            "on): a plan starts from doors that are one or the other"
        )
    return position >= opened


def _final(task: HomeTask, containers: Iterable[Container | None]) -> tuple[str, ...]:
    """Return all targets at their goals, the hand empty, and what the task's last stage asks for."""
    facts = [f"(at_goal target_{i})" for i in range(len(task.targets))] + ["(hand_empty)"]
    known = [container for container in dict.fromkeys(containers) if container is not None]
    for condition in task.stages[-1].conditions if task.stages else ():
        state, _, kind = condition.name.partition("_")
        if condition.name == "holding":
            facts.append(f"(holding target_{condition.target})")
        if state not in ("opened", "closed"):
            continue
        matching = [container for container in known if container.kind == kind]
        if not matching:
            raise PerdureError(f"{task.name} ends with {condition}, but none of its targets is in a {kind}")
        facts += [f"({'open' if state == 'opened' else 'closed'} {container.name})" for container in matching]
    return tuple(facts)


Fact = tuple[str, ...]
"""A predicate's name and its arguments; also an action's name and arguments."""
State = frozenset[Fact]


@dataclass(frozen=True)
class Action:
    """A ground action: a skill, or `next_target`."""

    name: Fact
    needs: State
    adds: State
    deletes: State

    @property
    def skill(self) -> str:
        """Its name alone."""
        return self.name[0]

    @property
    def target(self) -> int:
        """Number of the target it is about."""
        return int(self.name[1].removeprefix("target_"))


@dataclass(frozen=True)
class Strips:
    """A ground planning problem."""

    start: State
    goal: State
    actions: tuple[Action, ...]

    def shortest_plan(self) -> list[Action] | None:
        """Return the actions of a shortest plan, None when there is no plan."""
        came: dict[State, tuple[State, Action] | None] = {self.start: None}
        waiting = deque([self.start])
        while waiting:
            state = waiting.popleft()
            if self.goal <= state:
                actions = []
                while (step := came[state]) is not None:
                    state, action = step
                    actions.append(action)
                return actions[::-1]
            for action in self.actions:
                if action.needs <= state:
                    reached = (state - action.deletes) | action.adds
                    if reached not in came:
                        came[reached] = state, action
                        waiting.append(reached)
        return None


def read_strips(domain: str, problem: str) -> Strips:
    """Return the ground problem that a domain and a problem in PDDL describe.

    Raises:
        PerdureError: Parentheses do not match, or a condition is more than a conjunction of facts.
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
        raise PerdureError("PDDL must be one (define ...) with matching parentheses")
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
        raise PerdureError(f"plain STRIPS has no negative conditions, such as {negated[0]}")
    return facts


def _split(condition: list[Any]) -> tuple[list[Fact], list[Fact]]:
    """Return the facts of a conjunction, and those it negates."""
    literals = condition[1:] if condition[0] == "and" else [condition]
    facts = [tuple(each) for each in literals if each[0] != "not"]
    return facts, [tuple(each[1]) for each in literals if each[0] == "not"]
