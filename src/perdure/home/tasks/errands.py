"""Errands of a home that is never reset: a task with new goals, for objects where they are now.

An errand is an `Episode` that begins as the errand before it ended. It has the stages of its task, but those that open
or close a drawer or door in which none of its targets starts or ends.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np

from perdure.errors import PerdureError
from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.objects import Placement
from perdure.home.sim.occupancy import FreeSpace, free_space
from perdure.home.sim.pieces import INSIDE_MARGIN, LINK_CONTAINERS, Apartment, Pose, container_of
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.simulator import Simulator
from perdure.home.tasks.episodes import Episode, load_episodes, start_pose
from perdure.home.tasks.generation import APART, NAVIGABLE_WITHIN, PAIRINGS, PER_APARTMENT, Surfaces
from perdure.home.tasks.planners import ClosedLoop, needed_skills
from perdure.home.tasks.tasks import (
    ABOUT_CONTAINERS,
    PAST,
    TASKS,
    HomeTask,
    PlacementRule,
    Stage,
    TargetRule,
    get_task,
)

ABOVE = 0.2
"""An object whose middle is up to this in [m] above a surface lies on it (our choice: half the tallest is 0.11)."""
DRAWS = 20
"""Choices of targets and goals that are tried for one errand."""
NOWHERE = ""
"""Receptacle of an object that lies on none, such as one on the floor."""


@dataclass(frozen=True)
class HomeState:
    """A home between two errands."""

    objects: tuple[Placement, ...]
    """In the order of the home's first errand, whatever the targets of others are; on `NOWHERE` where that applies."""
    positions: Mapping[str, float]
    """How far each drawer and door is open, by link name."""
    base: Pose
    arm: tuple[float, ...]
    """Joint angles of the robot's arm."""

    @property
    def opened(self) -> dict[str, float]:
        """The positions of drawers and doors that are not closed, rounded to 1 cm or 0.01 rad, by link name."""
        limits = {link: container.closed for link, container in LINK_CONTAINERS.items()}
        found = self.positions.items()
        return {link: round(position, 2) for link, position in found if position > limits.get(link, math.inf)}


@dataclass(frozen=True)
class Errand(Episode):
    """A task in a home that is in use. `index` is that of the published episode in which the home began."""

    numbers: tuple[int, ...] = ()
    """The home's number of each of `objects`."""
    base: Pose = Pose(0.0, 0.0, 0.0)  # noqa: RUF009 - frozen
    """Where the robot stands at the start."""
    arm: tuple[float, ...] = ()
    """Joint angles of its arm at the start."""
    positions: Mapping[str, float] = field(default_factory=dict)
    """How far each drawer and door is open. `opened` has only those that a plan takes for open."""

    __hash__ = Episode.__hash__

    @cached_property
    def home_task(self) -> HomeTask:
        """The task, with its targets where they are and the stages that this takes."""
        count = len(self.goals)
        starts = tuple(placement.receptacle for placement in self.objects[:count])
        ends = tuple(placement.receptacle for placement in self.goals)
        containers = {link: LINK_CONTAINERS[link].name for link in self._links(starts + ends)}
        reached = [{containers[link] for link in self._links(pair)} for pair in zip(starts, ends, strict=True)]
        rules = tuple(
            (placement.kind, _name(start), _name(end))
            for placement, start, end in zip(self.objects, starts, ends, strict=False)
        )
        return _errand_task(get_task(self.task), rules, tuple(map(frozenset, reached)), tuple(self.opened.items()))

    def _links(self, receptacles: Sequence[str]) -> Iterator[str]:
        """Yield the links of the drawers and doors that must be opened to reach some receptacles."""
        apartment = self.apartment()
        for receptacle in receptacles:
            link = apartment.container(receptacle)
            if link is not None:
                yield link


def _name(receptacle: str) -> str:
    """Return the benchmark's name of a receptacle `piece|name`."""
    return receptacle.split("|")[-1]


@lru_cache(maxsize=1024)
def _errand_task(
    task: HomeTask,
    rules: tuple[tuple[str, str, str], ...],
    reached: tuple[frozenset[str], ...],
    opened: tuple[tuple[str, float], ...],
) -> HomeTask:
    """Return a task as an errand has it.

    Args:
        task: The task.
        rules: Kind, start and goal receptacle of each target.
        reached: The containers in which each target starts or ends.
        opened: Positions of drawers and doors that are open, by link name.
    """
    used = frozenset().union(*reached)
    stages = []
    for stage in task.stages:
        conditions = [each for each in stage.conditions if each.name not in ABOUT_CONTAINERS or each.container in used]
        # To open or close a container is a stage where the target is in one, and of those that the stage is about.
        wanted = PAST[stage.verb]
        about = {each.name for each in conditions}
        if wanted in ABOUT_CONTAINERS and (wanted not in about or not reached[stage.target]):
            continue
        stages.append(Stage(stage.verb, stage.target, tuple(conditions)))
    targets = tuple(
        TargetRule(PlacementRule((kind,), (start,)), PlacementRule((kind,), (end,))) for kind, start, end in rules
    )
    return replace(task, targets=targets, opened=dict(opened), stages=tuple(stages))


@lru_cache(maxsize=512)
def first_state(errands: tuple[str, ...], split: str, home: int, eval_seed: int) -> tuple[Episode, HomeState]:
    """Return the published episode in which a home begins, and the home's state then.

    Homes are the first episodes of each apartment of the split, then the second ones. The episode is one of the first
    of the named tasks whose start has what all of them need; of the first task where there is none. The evaluation seed
    draws the robot's start pose.

    Raises:
        PerdureError: If there is no such task, split or home.
    """
    found = []
    for task in dict.fromkeys(errands):
        episodes = load_episodes(task, split)
        each_apartment = PER_APARTMENT[split]
        apartments = len(episodes) // each_apartment
        if not 0 <= home < len(episodes):
            raise PerdureError(f"{split} has homes 0 to {len(episodes) - 1}, not {home}")
        episode = episodes[home % apartments * each_apartment + home // apartments]
        apartment = episode.apartment()
        positions = {each.link: episode.opened.get(each.link, 0.0) for each in apartment.articulations}
        pose = start_pose(apartment, episode, eval_seed)
        state = HomeState(episode.objects, positions, pose, tuple(ROBOT.rest_arm.tolist()))
        found.append((episode, state))
        if all(_can_choose(get_task(each), apartment, state) for each in errands):
            return episode, state
    return found[0]


def _can_choose(task: HomeTask, apartment: Apartment, state: HomeState) -> bool:
    """Return whether each target of a task may be an object that lies where the task's rules say."""
    left = list(range(len(state.objects)))
    for rule in task.targets:
        fitting = [k for k in left if _fits(rule.start, state.objects[k])]
        if not fitting:
            return False
        left.remove(fitting[0])
    return True


def _fits(rule: PlacementRule, placement: Placement) -> bool:
    return placement.kind in rule.objects and _name(placement.receptacle) in rule.receptacles


def draw_errand(task: str, first: Episode, state: HomeState, rng: np.random.Generator) -> Errand | None:
    """Return an errand of a task for a home as it is, None where none can be drawn.

    Each target is drawn among the objects of the rule's kinds that lie on its start receptacles; where there are none,
    among those on other surfaces, and in drawers and behind doors that the task's skills open. It must lie within 1.5 m
    of where the robot can stand. Goals are drawn as in published episodes (`perdure.home.tasks.generation`).

    Args:
        task: Name of the task.
        first: The episode in which the home began.
        state: The home now.
        rng: The random generator.
    """
    apartment = first.apartment()
    space = free_space(apartment, state.opened)
    for _ in range(DRAWS):
        chosen = _draw_targets(get_task(task), apartment, space, state, rng)
        if chosen is None:
            return None
        goals = _draw_goals(get_task(task), apartment, space, state, chosen, rng)
        if goals is not None:
            return _errand(task, first, state, chosen, goals)
    return None


def _draw_targets(
    task: HomeTask, apartment: Apartment, space: FreeSpace, state: HomeState, rng: np.random.Generator
) -> list[int] | None:
    """Return the home's numbers of the targets, None where a target has no candidate."""
    skills = needed_skills(task, ClosedLoop.name)
    there = [
        number
        for number, placement in enumerate(state.objects)
        if placement.receptacle != NOWHERE
        and space.nearest(np.array([placement.position[:2]]))[1][0] < NAVIGABLE_WITHIN
        and _opens(skills, apartment.container(placement.receptacle))
    ]
    chosen: list[int] = []
    for rule in task.targets:
        of_kind = [k for k in there if k not in chosen and state.objects[k].kind in rule.start.objects]
        usual = [k for k in of_kind if _fits(rule.start, state.objects[k])]
        candidates = usual or of_kind
        if not candidates:
            return None
        chosen.append(candidates[int(len(candidates) * rng.random())])
    return chosen


def _opens(skills: Sequence[str], link: str | None) -> bool:
    """Return whether some skills suffice to reach into a drawer or door, or into the open (None)."""
    return link is None or container_of(link).open_skill in skills


def _draw_goals(
    task: HomeTask,
    apartment: Apartment,
    space: FreeSpace,
    state: HomeState,
    chosen: Sequence[int],
    rng: np.random.Generator,
) -> list[Placement] | None:
    """Return the goal of each target, free of every object; None where one finds no room."""
    surfaces = Surfaces(apartment, space)
    for placement in state.objects:
        if placement.receptacle != NOWHERE:
            surfaces.add(placement)
    goals = []
    for number, rule in zip(chosen, task.targets, strict=True):
        goal = _draw_goal(surfaces, state.objects[number], rule.goal, rng)
        if goal is None:
            return None
        surfaces.add(goal)
        goals.append(goal)
    return goals


def _draw_goal(
    surfaces: Surfaces, placement: Placement, rule: PlacementRule, rng: np.random.Generator
) -> Placement | None:
    for _ in range(PAIRINGS):
        names = [each for name in rule.receptacles for each in surfaces.apartment.receptacles_named(name)]
        receptacle = names[int(len(names) * rng.random())]
        goal = surfaces.draw(placement.kind, receptacle, rng, rule.ratio, lift=0.0)
        if goal is not None and math.dist(goal.position, placement.position) >= APART:
            return goal
    return None


def _errand(task: str, first: Episode, state: HomeState, chosen: Sequence[int], goals: Sequence[Placement]) -> Errand:
    others = [number for number in range(len(state.objects)) if number not in chosen]
    numbers = (*chosen, *others)
    # A plan knows doors that are open or closed. One between them must be opened, and the closed loop closes it.
    limits = {link: container.opened for link, container in LINK_CONTAINERS.items()}
    positions = state.positions.items()
    return Errand(
        task,
        first.split,
        first.index,
        first.macro,
        first.micro,
        first.apartment_fingerprint,
        opened={link: position for link, position in positions if position >= limits.get(link, math.inf)},
        objects=tuple(state.objects[number] for number in numbers),
        goals=tuple(goals),
        numbers=numbers,
        base=state.base,
        arm=state.arm,
        positions=state.positions,
    )


def state_after(errand: Errand, lane: Simulator) -> HomeState:
    """Return the state in which an errand left a home. What the hand still held falls as the next errand begins."""
    scene = lane.scene
    positions = dict(zip(scene.links, lane.links.tolist(), strict=True))
    poses, _ = lane.objects(len(scene.placements))
    receptacles = find_receptacles(errand.apartment(), poses[:, :3], positions)
    if lane.held >= 0:
        receptacles[lane.held] = NOWHERE
    found: dict[int, Placement] = {}
    rows = zip(errand.numbers, errand.objects, poses.tolist(), receptacles, strict=True)
    for number, before, (x, y, z, qw, qx, qy, qz), receptacle in rows:
        found[number] = Placement(before.kind, (x, y, z), (qw, qx, qy, qz), receptacle)
    x, y, yaw = lane.robot[:3].tolist()
    base = Pose(x, y, math.remainder(yaw, math.tau))  # it grows with every turn
    arm = tuple(lane.robot[ROBOT.arm_columns].tolist())
    return HomeState(tuple(found[number] for number in sorted(found)), positions, base, arm)


def find_receptacles(apartment: Apartment, points: FloatArray, positions: Mapping[str, float]) -> list[str]:
    """Return the receptacle on which each of some objects lies, by its unique name; `NOWHERE` where there is none.

    It is the nearest one below the middle. Surfaces reach 0.1 m beyond the region in which objects are drawn.

    Args:
        apartment: Where they are.
        points: Middles of the objects in the room in [m]. Shape (n, 3).
        positions: How far drawers and doors are open, by link name.
    """
    found = [NOWHERE] * len(points)
    lowest = np.full(len(points), ABOVE)
    for each in apartment.receptacles:
        pose = apartment.piece(each.piece).pose
        middle = apartment.surface_to_room(each, np.zeros(2), positions)
        away = pose.to_local(points) - pose.to_local(middle)
        beside = (np.abs(away[:, :2]) < np.asarray(each.half) + INSIDE_MARGIN).all(axis=1)
        for row in np.flatnonzero(beside & (away[:, 2] >= 0.0) & (away[:, 2] < lowest)).tolist():
            found[row] = each.unique_name
            lowest[row] = away[row, 2]
    return found


def errand_generator(eval_seed: int, home: int, number: int, task: str) -> np.random.Generator:
    """Return the random generator of an errand: it depends on evaluation seed, home, number of the errand and task."""
    return np.random.Generator(np.random.PCG64([eval_seed, home, number, list(TASKS).index(task)]))
