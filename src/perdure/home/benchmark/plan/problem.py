"""Planning problems: the container of each target, what is open, and the goal."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

from perdure.home.benchmark.episodes import Episode
from perdure.home.benchmark.tasks import HomeTask, get_task
from perdure.home.benchmark.tasks.predicates import DRAWER_CLOSED, DRAWER_OPEN, FRIDGE_CLOSED, FRIDGE_OPENED
from perdure.home.errors import HomeError
from perdure.home.sim.apartments import FRIDGE_DOOR, Apartment, make_apartment
from perdure.home.sim.objects import Placement

Kind = Literal["drawer", "fridge"]
_SWITCHES: dict[Kind, tuple[float, float]] = {
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

    @property
    def containers(self) -> tuple[Container, ...]:
        """All containers, each once, in the order in which the targets need them."""
        pairs = zip(self.starts, self.ends, strict=True)
        return tuple(dict.fromkeys(c for pair in pairs for c in pair if c is not None))

    @property
    def pddl(self) -> str:
        """The problem as PDDL text."""
        count = len(self.starts)
        objects = [f"target_{i} - target goal_{i} - goal" for i in range(count)]
        objects += [f"{c.name} - {c.kind}" for c in self.containers]
        facts = ["(robot_at elsewhere)", "(hand_empty)", "(open in_the_open)", "(turn target_0)"]
        facts += [f"(next target_{i} target_{i + 1})" for i in range(count - 1)]
        facts += [f"({'open' if c.is_open else 'closed'} {c.name})" for c in self.containers]
        for i, (start, end) in enumerate(zip(self.starts, self.ends, strict=True)):
            facts += [f"(in target_{i} {_holder(start)})", f"(goal_of goal_{i} target_{i} {_holder(end)})"]
            landmarks = [f"target_{i}", f"goal_{i}", *dict.fromkeys(c.name for c in (start, end) if c is not None)]
            facts += [f"(concerns {landmark} target_{i})" for landmark in landmarks]
        name = re.sub(r"\W", "_", f"plan {self.name}", flags=re.ASCII)
        sections = [("objects", objects), ("init", facts), ("goal (and", [*self.final, ")"])]
        body = "".join(f"  (:{title}\n    {_lines(rows)})\n" for title, rows in sections)
        return f"(define (problem {name})\n  (:domain home)\n{body})\n"


def plan_problem(task: HomeTask | Episode | str) -> PlanProblem:
    """Return the planning problem of a task or an episode; an episode also says which drawer it is.

    Raises:
        HomeError: For an unknown task, one without targets, a door that is neither open nor closed at the start, a
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
        raise HomeError(f"{name} has no targets: there is nothing to plan")
    apartment = make_apartment(0, 0)  # any one: counter and fridge have the same drawers, door and names in all
    inside = [tuple(_container(apartment, names, opened, name) for names in side) for side in (starts, ends)]
    if sum(container is not None and container.name == _SOME_DRAWER for side in inside for container in side) > 1:
        raise HomeError(f"several targets of {name} are in one drawer or another: ask for the plan of an episode")
    return PlanProblem(name, inside[0], inside[1], _final(home_task, (*inside[0], *inside[1])))


def _receptacles(placements: Iterable[Placement]) -> list[tuple[str, ...]]:
    """Return the receptacle of each placement, by the benchmark's name."""
    return [(placement.receptacle.split("|")[-1],) for placement in placements]


def _container(
    apartment: Apartment, receptacles: Iterable[str], opened: Mapping[str, float], name: str
) -> Container | None:
    """Return the container that must be opened to reach any of these receptacles."""
    links = sorted({_link(apartment, receptacle) for receptacle in receptacles})
    kinds = {_kind(link) for link in links}
    states = {_is_open(link, opened.get(link, 0.0), name) for link in links if link}
    if len(kinds) != 1 or len(states) > 1:
        raise HomeError(
            f"{name} leaves open what a target is in ({', '.join(link or 'in the open' for link in links)}) "
            "and the plans differ: ask for the plan of an episode"
        )
    (kind,) = kinds
    if kind is None:
        return None
    return Container(links[0] if len(links) == 1 else _SOME_DRAWER, kind, states == {True})


def _link(apartment: Apartment, receptacle: str) -> str:
    """Return link of the drawer or door in front of a receptacle, empty when it is in the open."""
    return apartment.container(apartment.receptacles_named(receptacle)[0].unique_name) or ""


def _kind(link: str) -> Kind | None:
    if not link:
        return None
    return "fridge" if link == FRIDGE_DOOR else "drawer"


def _is_open(link: str, position: float, name: str) -> bool:
    kind = _kind(link) or "drawer"
    closed, opened = _SWITCHES[kind]
    if closed < position < opened:
        raise HomeError(
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
            raise HomeError(f"{task.name} ends with {condition}, but none of its targets is in a {kind}")
        facts += [f"({'open' if state == 'opened' else 'closed'} {container.name})" for container in matching]
    return tuple(facts)


def _holder(container: Container | None) -> str:
    return "in_the_open" if container is None else container.name


def _lines(rows: Iterable[str]) -> str:
    return "\n    ".join(rows)
