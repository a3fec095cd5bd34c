"""Planners: which skill is next in an episode.

`Planner` is a vocabulary (`perdure.registry`): `perdure home run --planner NAME` finds each of its classes.

Open loop: the task's plan, whatever happens. Closed loop: after each skill the symbolic state is read and the rest is
planned again in the same PDDL domain. It reads four things that a robot would have to perceive: where the targets are
(in their goals, in a container, elsewhere), how far each container is open, what the hand holds, and whether the
last skill succeeded. The simulator tells them without error.

A learned retry begins at another cell of the region of navigation. With the fallback "oracle" the skill is scripted
after `LEARNED` failures, and so is its last attempt; with "none" it never is. Every skill has `ATTEMPTS` attempts with
a target, so no recovery goes on for ever; then the target is given up and the others are brought. The end of the plan
is not the end: whoever asks again later is told what has rolled away since.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections import Counter
from dataclasses import replace
from typing import ClassVar, Literal

import numpy as np

from perdure.errors import lookup
from perdure.home.sim.pieces import CONTAINERS, container_of
from perdure.home.tasks.domain import ELSEWHERE
from perdure.home.tasks.episodes import Episode
from perdure.home.tasks.planning import ContainerState, PlannedSkill, PlanProblem, make_plan, plan_problem, solve
from perdure.home.tasks.tasks import (
    NOTHING,
    SKILL_CONTAINERS,
    SKILL_VERBS,
    HomeTask,
    SkillStep,
    Verb,
    WorldFacts,
    at,
    container_position,
)
from perdure.registry import Registered

FallbackName = Literal["oracle", "none"]
"""Who acts after `LEARNED` failures of a skill: "oracle", or "none": the policy goes on until its attempts are over."""
LEARNED = 3
"""Failures of a skill with a target after which it is scripted (our choice)."""
ATTEMPTS = 5
"""Attempts of a skill with a target in all (our choice)."""
WAYS = 2
"""Failed navigations to an attempt after which it begins wherever the robot stands (our choice)."""
NOT_AT_START = 0.1
"""The planner looks for an object again that is farther than this in [m] from its start."""


class Planner(Registered):
    """Which skill is next in an episode."""

    words: ClassVar[str]
    """What it does, for tables, figures and the command line: "planned again after each skill"."""
    has_fallback: ClassVar[bool] = False
    """Whether the oracle takes over what failed often, unless the fallback is "none"."""

    def __init__(self, episode: Episode, fallback: FallbackName = "oracle") -> None:
        """Begin at the start of an episode."""
        self._episode = episode
        self._fallback = fallback

    @classmethod
    def skills(cls, task: HomeTask) -> tuple[str, ...]:
        """Return the skills that it may choose in a task: those of the task's plan."""
        return tuple(dict.fromkeys(step.skill for step in make_plan(task)))

    @abstractmethod
    def next(self, facts: WorldFacts, succeeded: bool = True) -> SkillStep | None:
        """Return the next step, None when the plan is done.

        `facts` are those of now, without leading axes; `succeeded` is whether the last step did.
        """

    def seen(self, facts: WorldFacts, step: SkillStep) -> Episode:
        """Return the episode with the target of a step where the planner believes it to be: at its start."""
        return self._episode


class OpenLoop(Planner):
    """The plan of the task, whatever happens."""

    name = "open"
    words = "the task's plan, whatever happens"

    def __init__(self, episode: Episode, fallback: FallbackName = "oracle") -> None:
        """Begin at the start of an episode."""
        super().__init__(episode, fallback)
        self._steps = iter(make_plan(episode.home_task))

    def next(self, facts: WorldFacts, succeeded: bool = True) -> SkillStep | None:
        """See `Planner.next`."""
        return next(self._steps, None)


class ClosedLoop(Planner):
    """Plans again after each skill."""

    name = "closed"
    words = "planned again after each skill"
    has_fallback = True

    def __init__(self, episode: Episode, fallback: FallbackName = "oracle") -> None:
        """Begin at the start of an episode."""
        super().__init__(episode, fallback)
        self._problem = replace(plan_problem(episode), name=episode.task)
        self._attempts = Counter[tuple[str, int]]()
        self._given_up = set[int]()
        self._failures = Counter[SkillStep]()
        """Of a skill with a target (attempt 0), and of the navigations to each of its attempts."""
        self._last: tuple[SkillStep, PlannedSkill] | None = None
        """The step that `reset_arm` follows next."""
        self._robot_at = ELSEWHERE

    @classmethod
    def skills(cls, task: HomeTask) -> tuple[str, ...]:
        """See `Planner.skills`; it also opens the task's containers."""
        opening = [CONTAINERS[each.container].open_skill for each in plan_problem(task).containers]
        return tuple(dict.fromkeys([*super().skills(task), *opening]))

    def next(self, facts: WorldFacts, succeeded: bool = True) -> SkillStep | None:
        """See `Planner.next`; `reset_arm` follows every skill."""
        if self._last is not None:
            step, planned = self._last
            self._last = None
            self._note(step, planned, succeeded)
            return SkillStep(Verb.RESET_ARM.value, step.target)
        chosen = self._choose(facts)
        if chosen is None:
            return None
        first, acting = chosen
        attempt = self._attempts[acting.skill, acting.target] + 1
        toward = acting.skill if first is not acting else None
        if toward is None:
            self._attempts[first.skill, first.target] = attempt
        failed = self._failures[SkillStep(acting.skill, acting.target, attempt=0)]
        scripted = self._fallback == "oracle" and (failed >= LEARNED or attempt == ATTEMPTS)
        step = SkillStep(first.skill, first.target, toward, attempt, scripted)
        self._last = (step, first)
        return step

    def _note(self, step: SkillStep, planned: PlannedSkill, succeeded: bool) -> None:
        """Count a failure of the last step, and remember where the robot stands after it, if that is known."""
        key = step if step.toward else SkillStep(step.skill, step.target, attempt=0)
        self._failures[key] += not succeeded
        if succeeded or (step.toward is not None and self._failures[step] >= WAYS):
            self._robot_at = planned.robot_at or self._robot_at
        else:
            self._robot_at = ELSEWHERE

    def _choose(self, facts: WorldFacts) -> tuple[PlannedSkill, PlannedSkill] | None:
        """Return the next skill and the first one that is no navigation; None when nothing is left to do."""
        while plan := solve(self._now(facts)):
            acting = next(each for each in plan if each.skill != Verb.NAVIGATE)
            if self._attempts[acting.skill, acting.target] < ATTEMPTS:
                return plan[0], acting
            if SKILL_VERBS.get(acting.skill) == Verb.CLOSE:
                still_wanted = [fact for fact in self._problem.final if fact != ("closed", acting.link)]
                self._problem = replace(self._problem, final=tuple(still_wanted))
            elif acting.target in self._given_up:
                break
            else:
                self._given_up.add(acting.target)
        return None

    def _now(self, facts: WorldFacts) -> PlanProblem:
        """Return the planning problem from the state as it is."""
        problem = self._problem
        held = int(facts.held)
        targets = range(facts.targets)
        # Where the targets are: the link of a container, None in the open or in the hand.
        placed = {i for i in targets if at(facts)[i] and i != held} | self._given_up
        inside = [None if i == held else find_container(self._episode, i, facts) for i in targets]
        ends = [None if end is None else end.link for end in problem.ends]
        # Which containers must be open: a full hand opens nothing.
        bring = [i for i in targets if i not in placed and held == NOTHING]
        needed = {link for i in bring for link in (inside[i], ends[i])}
        now = {each.link: _seen(each, facts, each.link in needed) for each in problem.containers}
        return replace(
            problem,
            starts=tuple(None if each is None else now[each.link] for each in problem.starts),
            ends=tuple(now.get(link or "") for link in ends),
            inside=tuple(now.get(link or "") for link in inside),
            placed=frozenset(placed),
            held=held,
            robot_at=self._robot_at,
        )

    def seen(self, facts: WorldFacts, step: SkillStep) -> Episode:
        """Return the episode with an object to pick where it lies, and the target of a door behind it."""
        episode = self._episode
        target = step.target
        skill = step.toward or step.skill
        start = episode.objects[target]
        placement = start
        x, y, z = map(float, facts.object_positions[target])
        if skill == Verb.PICK and math.dist((x, y, z), start.position) > NOT_AT_START:
            nearest = _nearest_receptacle(episode, find_container(episode, target, facts), (x, y, z))
            placement = replace(start, position=(x, y, z), receptacle=nearest)
        elif skill in SKILL_CONTAINERS:
            start_in = self._problem.starts[target]
            if start_in is None or start_in.container != SKILL_CONTAINERS[skill]:
                placement = replace(start, receptacle=episode.goals[target].receptacle)
        return replace(episode, objects=(*episode.objects[:target], placement, *episode.objects[target + 1 :]))


def _nearest_receptacle(episode: Episode, link: str | None, point: tuple[float, float, float]) -> str:
    """Return the nearest receptacle in a container, in the open when None, by its unique name."""
    home = episode.apartment()
    there = [each for each in home.receptacles if home.container(each.unique_name) == link]
    middles = np.array([home.surface_to_room(each, np.zeros(2)) for each in there])
    nearest = int(np.linalg.norm(middles - point, axis=1).argmin())
    return there[nearest].unique_name


def _seen(state: ContainerState, facts: WorldFacts, needed: bool) -> ContainerState:
    """Return a container as it stands; one that is neither open nor closed counts as what must be changed."""
    container = CONTAINERS[state.container]
    position = float(container_position(facts, state.container))
    return replace(state, is_open=position >= container.opened or (position > container.closed and not needed))


def find_container(episode: Episode, target: int, facts: WorldFacts) -> str | None:
    """Return the drawer or door behind which a target lies, a link name; None in the open."""
    apartment = episode.apartment()
    point = np.asarray(facts.object_positions[target])
    for name in (episode.objects[target].receptacle, episode.goals[target].receptacle):
        link = apartment.container(name)
        if link is None:
            continue
        opened = {link: float(container_position(facts, container_of(link).name))}
        if apartment.is_inside(apartment.receptacle(name), point, opened):
            return link
    return None


def find_planner(name: str) -> type[Planner]:
    """Return the planner of a name; PerdureError when there is none."""
    return lookup(Planner.kinds(), name, "planner")


def needed_skills(task: HomeTask, planner: str) -> tuple[str, ...]:
    """Return the skills that the planner of a name may choose in a task."""
    return find_planner(planner).skills(task)
