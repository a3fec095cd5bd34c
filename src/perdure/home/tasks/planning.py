"""Plans: the planning problem of a task or an episode, and the skills of its shortest plan."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

from perdure.errors import PerdureError
from perdure.home.sim.apartments import make_apartment
from perdure.home.sim.objects import Placement
from perdure.home.sim.pieces import Apartment, container_of
from perdure.home.tasks.domain import ELSEWHERE, HOME, IN_THE_OPEN, NEXT_TARGET
from perdure.home.tasks.episodes import Episode
from perdure.home.tasks.strips import Action, Fact, Typed, fact_text, ground
from perdure.home.tasks.tasks import (
    NOTHING,
    SKILL_CONTAINERS,
    HomeTask,
    SkillName,
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
    home_task = task_of(task)
    if home_task.sequence:
        return home_task.sequence
    problem = plan_problem(task)
    plan = solve(problem)
    if plan is None:
        final = " ".join(fact_text(fact) for fact in problem.final)
        raise PerdureError(f"no plan solves {problem.name}: no sequence of skills ends with {final}")
    return with_resets(*((each.skill, each.target) for each in plan))


def task_of(task: HomeTask | Episode | str) -> HomeTask:
    """Return a task from itself, its name or one of its episodes."""
    if isinstance(task, Episode):
        return task.home_task
    return get_task(task) if isinstance(task, str) else task


@dataclass(frozen=True)
class PlannedSkill:
    """A skill of a plan."""

    skill: SkillName
    target: int
    """Number of the target it is about."""
    link: str | None
    """The drawer or door that it opens or closes."""
    robot_at: str | None
    """The landmark at which the robot stands after it; None when it stands where it stood."""


@lru_cache(maxsize=4096)
def solve(problem: PlanProblem) -> tuple[PlannedSkill, ...] | None:
    """Return the skills of a shortest plan, None when there is no plan."""
    actions = ground(HOME, problem.objects, frozenset(problem.start), frozenset(problem.final)).shortest_plan()
    if actions is None:
        return None
    numbers = {target_name(i): i for i in range(len(problem.starts))}
    return tuple(_planned(action, numbers) for action in actions if action.name != NEXT_TARGET)


def _planned(action: Action, numbers: Mapping[str, int]) -> PlannedSkill:
    link = action.arguments[1] if action.name in SKILL_CONTAINERS else None
    robot_at = next((fact[1] for fact in action.adds if fact[0] == "robot_at"), None)
    return PlannedSkill(action.name, numbers[action.arguments[0]], link, robot_at)


def target_name(number: int) -> str:
    """Return a target's name in planning problems."""
    return f"target_{number}"


@dataclass(frozen=True)
class ContainerState:
    """A drawer or door of a planning problem."""

    link: str
    """Its link, such as `drawer2_top`; `some_drawer` where only an episode says which one."""
    container: str
    """What it is: a key of `CONTAINERS`."""
    is_open: bool

    @property
    def fact(self) -> Fact:
        """Whether it is open, as a fact of the domain."""
        return ("open" if self.is_open else "closed", self.link)


@dataclass(frozen=True)
class PlanProblem:
    """One planning problem; `None` instead of a container means in the open."""

    name: str
    starts: tuple[ContainerState | None, ...]
    """Container of each target at the start."""
    ends: tuple[ContainerState | None, ...]
    """Container of each target's goal."""
    final: tuple[Fact, ...]
    """The goal, as facts of the domain."""
    inside: tuple[ContainerState | None, ...]
    """Container of each target now."""
    placed: frozenset[int] = frozenset()
    """Targets at their goals."""
    held: int = NOTHING
    """Number of the target in the hand, NOTHING or SOMETHING_ELSE. Its turn is the first."""
    robot_at: str = ELSEWHERE
    """The landmark where the robot stands."""

    @property
    def containers(self) -> tuple[ContainerState, ...]:
        """All containers, each once, in the order in which the targets need them."""
        pairs = zip(self.starts, self.ends, strict=True)
        return tuple(dict.fromkeys(c for pair in pairs for c in pair if c is not None))

    @property
    def objects(self) -> Typed:
        """All objects of the problem with their types."""
        found = []
        for i in range(len(self.starts)):
            found += [(target_name(i), "target"), (_goal_name(i), "goal")]
        return (*found, *((each.link, each.container) for each in self.containers))

    @property
    def start(self) -> tuple[Fact, ...]:
        """All facts that are true now."""
        order = sorted(range(len(self.starts)), key=lambda i: i != self.held)
        facts: list[Fact] = [("robot_at", self.robot_at)]
        if self.held == NOTHING:
            facts.append(("hand_empty",))
        elif self.held >= 0:
            facts.append(("holding", target_name(self.held)))
        facts += [("open", IN_THE_OPEN), ("turn", target_name(order[0]))]
        facts += [("next", target_name(i), target_name(k)) for i, k in pairwise(order)]
        facts += [("at_goal", target_name(i)) for i in sorted(self.placed)]
        facts += [each.fact for each in self.containers]
        for i in range(len(self.starts)):
            facts += self._target_facts(i)
        return tuple(facts)

    def _target_facts(self, i: int) -> Iterator[Fact]:
        """Yield where a target is and belongs, and the landmarks to which handling it may lead."""
        target = target_name(i)
        goal = _goal_name(i)
        if i != self.held:
            yield ("in", target, _holder(self.inside[i]))
        yield ("goal_of", goal, target, _holder(self.ends[i]))
        containers = [each.link for each in (self.starts[i], self.ends[i]) if each is not None]
        for landmark in dict.fromkeys([target, goal, *containers]):
            yield ("concerns", landmark, target)


def _goal_name(number: int) -> str:
    return f"goal_{number}"


def _holder(container: ContainerState | None) -> str:
    return IN_THE_OPEN if container is None else container.link


def plan_problem(task: HomeTask | Episode | str) -> PlanProblem:
    """Return the planning problem of a task or an episode; an episode also says which drawer it is.

    Raises:
        PerdureError: For an unknown task, one without targets, a door that is neither open nor closed at the start, a
            target that may lie in containers of different kinds, or a condition about a container no target is in.
    """
    home_task = task_of(task)
    if isinstance(task, Episode):
        name = task.name
        opened = task.opened
        starts = _receptacles(task.objects[: len(task.goals)])
        ends = _receptacles(task.goals)
    else:
        name = home_task.name
        opened = home_task.opened
        starts = [rule.start.receptacles for rule in home_task.targets]
        ends = [rule.goal.receptacles for rule in home_task.targets]
    if not starts:
        raise PerdureError(f"{name} has no targets: there is nothing to plan")
    apartment = make_apartment(0, 0)  # any one: all have the same containers, with the same names
    first = tuple(_container(apartment, names, opened, name) for names in starts)
    last = tuple(_container(apartment, names, opened, name) for names in ends)
    found = [each for each in (*first, *last) if each is not None]
    for kind in {each.container for each in found}:
        if [each.link for each in found].count(_some(kind)) > 1:
            raise PerdureError(
                f"several targets of {name} are in one {kind} or another: ask for the plan of an episode"
            )
    return PlanProblem(name, first, last, _final(home_task, found), first)


def _receptacles(placements: Iterable[Placement]) -> list[tuple[str, ...]]:
    """Return the receptacle of each placement, by the benchmark's name."""
    return [(placement.receptacle.split("|")[-1],) for placement in placements]


def _some(container: str) -> str:
    """Return the name of a container's link that only an episode knows."""
    return f"some_{container}"


def _container(
    apartment: Apartment, receptacles: Iterable[str], opened: Mapping[str, float], name: str
) -> ContainerState | None:
    """Return the container that must be opened to reach any of these receptacles."""
    found = {apartment.container(apartment.receptacles_named(each)[0].unique_name) for each in receptacles}
    links = sorted(link or "" for link in found)
    kinds = {None if link is None else container_of(link).name for link in found}
    states = {_is_open(link, opened.get(link, 0.0), name) for link in found if link}
    if len(kinds) != 1 or len(states) > 1:
        raise PerdureError(
            f"{name} leaves open what a target is in ({', '.join(link or 'in the open' for link in links)}) "
            "and the plans differ: ask for the plan of an episode"
        )
    (kind,) = kinds
    if kind is None:
        return None
    return ContainerState(links[0] if len(links) == 1 else _some(kind), kind, states == {True})


def _is_open(link: str, position: float, name: str) -> bool:
    container = container_of(link)
    if container.closed < position < container.opened:
        raise PerdureError(
            f"{link} of {name} stands at {position:g}, neither closed (up to {container.closed:g}) nor open (from "
            f"{container.opened:g} on): a plan starts from doors that are one or the other"
        )
    return position >= container.opened


def _final(task: HomeTask, containers: Sequence[ContainerState]) -> tuple[Fact, ...]:
    """Return all targets at their goals, the hand empty, and what the task's last stage asks for."""
    facts: list[Fact] = [("at_goal", target_name(i)) for i in range(len(task.targets))]
    facts.append(("hand_empty",))
    for condition in task.stages[-1].conditions if task.stages else ():
        if condition.name == "holding" and condition.target is not None:
            facts.append(("holding", target_name(condition.target)))
        if condition.container is None:
            continue
        links = dict.fromkeys(each.link for each in containers if each.container == condition.container)
        if not links:
            raise PerdureError(
                f"{task.name} ends with {condition}, but none of its targets is in a {condition.container}"
            )
        facts += [("open" if condition.name == "opened" else "closed", link) for link in links]
    return tuple(facts)
