"""Planners: which skill is next in an episode.

Open loop: the task's plan, whatever happens. Closed loop: after each skill the symbolic state is read and the rest is
planned again in the same PDDL domain. It reads four things that a robot would have to perceive: where the targets are
(in their goals, in a container, elsewhere), how far drawer and fridge are open, what the hand holds, and whether the
last skill succeeded. The simulator tells them without error.

A learned retry begins at another cell of the region of navigation; after `LEARNED` failures the skill is scripted,
unless the fallback is "none". Every skill has `ATTEMPTS` attempts with a target, the last one scripted, so no recovery
goes on for ever; then the target is given up and the others are brought. The end of the plan is not the end: whoever
asks again later is told what has rolled away since.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from typing import Literal

import numpy as np

from perdure.home.sim.pieces import FRIDGE_DOOR
from perdure.home.tasks.episodes import Episode
from perdure.home.tasks.planning import SWITCHES, Action, Container, PlanProblem, make_plan, plan_problem, solve
from perdure.home.tasks.tasks import NOTHING, HomeTask, SkillStep, WorldFacts, at

PlannerName = Literal["open", "closed"]
FallbackName = Literal["oracle", "none"]
"""Who acts after `LEARNED` failures of a skill: "oracle", or "none": the policy goes on until its attempts are over."""
LEARNED, ATTEMPTS = 3, 5
"""Failures of a skill with a target after which it is scripted, and attempts in all (our choice)."""
WAYS = 2
"""Failed navigations to an attempt after which it begins wherever the robot stands (our choice)."""
BESIDE, BELOW = 0.1, 0.1
"""Margins in [m] around a receptacle in which an object still lies in it."""
MOVED = 0.1
"""An object farther than this in [m] from its start has moved."""


class Planner:
    """Open loop: the plan of the task, whatever happens. Other planners inherit."""

    def __init__(self, episode: Episode, fallback: FallbackName = "oracle") -> None:
        """Begin at the start of an episode; without a planner that looks there is no fallback."""
        self._episode, self._steps = episode, iter(make_plan(episode.home_task))

    def next(self, facts: WorldFacts, succeeded: bool = True) -> SkillStep | None:
        """Return the next step, None when the plan is done.

        `facts` are those of now, without leading axes; `succeeded` is whether the last step did.
        """
        return next(self._steps, None)

    def seen(self, facts: WorldFacts, step: SkillStep) -> Episode:
        """Return the episode with the target of a step where the planner believes it to be: at its start."""
        return self._episode


class ClosedLoop(Planner):
    """Plans again after each skill."""

    def __init__(self, episode: Episode, fallback: FallbackName = "oracle") -> None:
        """Begin at the start of an episode."""
        super().__init__(episode, fallback)
        self._fallback = fallback
        self._problem = replace(plan_problem(episode), name=episode.task)
        self._attempts, self._given_up = Counter[tuple[str, int]](), set[int]()
        self._failures = Counter[SkillStep]()
        """Of a skill with a target (attempt 0), and of the navigations to each of its attempts."""
        self._last: tuple[SkillStep, Action] | None = None
        """The step that `reset_arm` follows next."""
        self._robot_at = PlanProblem.robot_at

    def next(self, facts: WorldFacts, succeeded: bool = True) -> SkillStep | None:
        """See `Planner.next`; `reset_arm` follows every skill."""
        if self._last is not None:
            (step, action), self._last = self._last, None
            key = step if step.toward else SkillStep(step.skill, step.target, attempt=0)
            self._failures[key] += not succeeded
            there = [fact[1] for fact in action.adds if fact[0] == "robot_at"]
            known = succeeded or (step.toward is not None and self._failures[step] >= WAYS)
            self._robot_at = next(iter(there), self._robot_at) if known else PlanProblem.robot_at
            return SkillStep("reset_arm", step.target)
        if (chosen := self._choose(facts)) is None:
            return None
        first, acting = chosen
        attempt = self._attempts[acting.skill, acting.target] + 1
        toward = acting.skill if first is not acting else None
        if toward is None:
            self._attempts[first.skill, first.target] = attempt
        failed = self._failures[SkillStep(acting.skill, acting.target, attempt=0)]
        scripted = self._fallback == "oracle" and (failed >= LEARNED or attempt == ATTEMPTS)
        self._last = SkillStep(first.skill, first.target, toward, attempt, scripted), first
        return self._last[0]

    def _choose(self, facts: WorldFacts) -> tuple[Action, Action] | None:
        """Return the next action and the first one that is no navigation; None when nothing is left to do."""
        while plan := solve(self._now(facts)):
            acting = next(action for action in plan if action.skill != "navigate")
            if self._attempts[acting.skill, acting.target] < ATTEMPTS:
                return plan[0], acting
            if acting.skill.startswith("close"):
                door = f"(closed {acting.name[2]})"
                self._problem = replace(self._problem, final=tuple(f for f in self._problem.final if f != door))
            elif acting.target in self._given_up:
                break
            else:
                self._given_up.add(acting.target)
        return None

    def _now(self, facts: WorldFacts) -> PlanProblem:
        """Return the planning problem from the state as it is."""
        problem, held, targets = self._problem, int(facts.held), range(facts.targets)
        placed = {i for i in targets if at(facts)[i] and i != held} | self._given_up
        links = [None if i == held else find_container(self._episode, i, facts) for i in targets]
        ends = [None if end is None else end.name for end in problem.ends]
        bring = [i for i in targets if i not in placed and held == NOTHING]  # a full hand opens nothing
        needed = {name for i in bring for name in (links[i], ends[i])}
        now = {each.name: _seen(each, facts, each.name in needed) for each in problem.containers}
        return replace(
            problem,
            starts=tuple(None if each is None else now[each.name] for each in problem.starts),
            ends=tuple(now.get(name or "") for name in ends),
            inside=tuple(now.get(link or "") for link in links),
            placed=frozenset(placed),
            held=held,
            robot_at=self._robot_at,
        )

    def seen(self, facts: WorldFacts, step: SkillStep) -> Episode:
        """Return the episode with an object to pick where it lies, and the target of a door behind it."""
        episode, target, skill = self._episode, step.target, step.toward or step.skill
        placement = start = episode.objects[target]
        start_in, kind = self._problem.starts[target], skill.partition("_")[2]
        x, y, z = map(float, facts.object_positions[target])
        if skill == "pick" and math.dist((x, y, z), start.position) > MOVED:
            home, link = episode.apartment(), find_container(episode, target, facts)
            there = [each for each in home.receptacles if home.container(each.unique_name) == link]
            middles = np.array([home.surface_to_room(each, np.zeros(2)) for each in there])
            nearest = there[int(np.linalg.norm(middles - (x, y, z), axis=1).argmin())]
            placement = replace(start, position=(x, y, z), receptacle=nearest.unique_name)
        elif kind in SWITCHES and (start_in is None or start_in.kind != kind):
            placement = replace(start, receptacle=episode.goals[target].receptacle)
        return replace(episode, objects=(*episode.objects[:target], placement, *episode.objects[target + 1 :]))


def _seen(container: Container, facts: WorldFacts, needed: bool) -> Container:
    """Return a container as it stands; one that is neither open nor closed counts as what must be changed."""
    closed, opened = SWITCHES[container.kind]
    position = float(facts.fridge if container.kind == "fridge" else facts.drawer)
    return replace(container, is_open=position >= opened or (position > closed and not needed))


def find_container(episode: Episode, target: int, facts: WorldFacts) -> str | None:
    """Return the drawer or door behind which a target lies, a link name; None in the open."""
    apartment, point = episode.apartment(), np.asarray(facts.object_positions[target])
    for name in (episode.objects[target].receptacle, episode.goals[target].receptacle):
        receptacle, link = apartment.receptacle(name), apartment.container(name)
        if link is None:
            continue
        opened = {link: float(facts.fridge if link == FRIDGE_DOOR else facts.drawer)}
        pose = apartment.piece(receptacle.piece).pose
        away = pose.to_local(point) - pose.to_local(apartment.surface_to_room(receptacle, np.zeros(2), opened))
        level = link == FRIDGE_DOOR or -BELOW < away[2] < receptacle.headroom  # any shelf of the fridge will do
        if level and (np.abs(away[:2]) < np.asarray(receptacle.half) + BESIDE).all():
            return link
    return None


PLANNERS: dict[str, type[Planner]] = {"open": Planner, "closed": ClosedLoop}


def needed_skills(task: HomeTask, planner: PlannerName) -> tuple[str, ...]:
    """Return the skills that a planner may choose; a closed loop also opens the task's containers."""
    kinds = [each.kind for each in plan_problem(task).containers] if planner != "open" else []
    return tuple(dict.fromkeys([*(step.skill for step in make_plan(task)), *(f"open_{kind}" for kind in kinds)]))
