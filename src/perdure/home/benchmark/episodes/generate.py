"""Generation of episodes by the benchmark's rules alone; solvability by any agent plays no part.

The rules are those of habitat-lab's generator (`habitat/datasets/rearrange/rearrange_generator.py`) with M3's
configurations: receptacles of targets and goals are drawn first; then objects are placed, targets before clutter, each
uniform on a receptacle drawn uniformly among those allowed, upright with a random heading; then everything settles for
5 s, and an episode in which anything moved by more than 0.1 m is thrown away; then goals are drawn, free of every
object, and an episode with a goal closer than 0.5 m to its object's start is thrown away. Targets and goals lie within
1.5 m of where the robot can stand.

Two additions (OURS): in TidyHouse too the robot must be able to stand near, and no goal overlaps another.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from perdure.home.benchmark.episodes.episode import Episode, EpisodeSet
from perdure.home.benchmark.episodes.settle import MOVED, settle
from perdure.home.benchmark.episodes.surfaces import ObjectModels, Surfaces
from perdure.home.benchmark.tasks import TASKS, HomeTask, PlacementRule, get_task
from perdure.home.errors import HomeError
from perdure.home.sim.apartments import Apartment, Receptacle, free_space, make_apartment, split_apartments
from perdure.home.sim.objects import Placement

APART = 0.5
"""Smallest distance in [m] from a target's start to its goal."""
PAIRINGS = 100
"""Pairs of object and receptacle tried for one object."""
PER_APARTMENT = {"train": 100, "val": 5, "eval": 5}
"""Episodes in each apartment of a split, as in M3."""
_EPISODES = 1000

Refusal = Callable[[str], None]


def generate_episodes(
    task: str,
    split: str,
    models: ObjectModels,
    seed: int = 0,
    refused: Refusal = lambda reason: None,
    per_apartment: int | None = None,
) -> EpisodeSet:
    """Return all episodes of a task and split (`train`, `val` or `eval`); another seed gives other episodes.

    `refused` is called with the reason whenever a draw is thrown away. `per_apartment`: M3's number when None.
    """
    apartments = split_apartments(split)
    count = PER_APARTMENT[split] if per_apartment is None else per_apartment
    episodes = tuple(
        generate_episode(task, split, number * count + k, apartment, models, seed, refused)
        for number, apartment in enumerate(apartments)
        for k in range(count)
    )
    return EpisodeSet(task, split, {"seed": str(seed)}, episodes)


def generate_episode(
    task: str,
    split: str,
    index: int,
    apartment: tuple[int, int],
    models: ObjectModels,
    seed: int = 0,
    refused: Refusal = lambda reason: None,
) -> Episode:
    """Return one episode in the apartment (macro, micro); it depends on its arguments only, not on other episodes.

    `refused` is called with the reason whenever a draw is thrown away.
    """
    home_task, home = get_task(task), make_apartment(*apartment)
    rng = np.random.Generator(np.random.PCG64([seed, list(TASKS).index(task), *apartment, index]))
    for _ in range(_EPISODES):
        drawn = _draw(home_task, home, models, rng)
        if isinstance(drawn, str):
            refused(drawn)
            continue
        objects, goals = drawn
        opened = dict(home_task.opened)
        return Episode(task, split, index, home.macro, home.micro, home.fingerprint, opened, objects, goals)
    raise HomeError(f"no episode {index} of {task} in {home.name}: {_EPISODES} draws were thrown away")


def _draw(
    task: HomeTask, apartment: Apartment, models: ObjectModels, rng: np.random.Generator
) -> tuple[tuple[Placement, ...], tuple[Placement, ...]] | str:
    """Return objects and goals, or the reason why this draw is thrown away."""
    space = free_space(apartment, task.opened)
    surfaces = Surfaces(apartment, space, models)
    starts = [_any_of(apartment, target.start, rng) for target in task.targets]
    ends = [_any_of(apartment, target.goal, rng) for target in task.targets]
    objects = _draw_objects(task, surfaces, starts, rng)
    if objects is None:
        return "no room for the objects"
    objects, moved, _ = settle(apartment, dict(task.opened), objects, models)
    if (moved > MOVED).any():
        return "an object was not stable"
    after = Surfaces(apartment, space, models)
    for placement in objects:
        after.add(placement)
    goals = []
    for target, rule, end in zip(objects, task.targets, ends, strict=False):
        goal = after.draw(target.kind, end, rng, rule.goal.ratio, lift=0.0)
        if goal is None:
            return "no room for a goal"
        if np.linalg.norm(np.subtract(goal.position, target.position)) < APART:
            return "a goal is too close to its start"
        after.add(goal)
        goals.append(goal)
    return objects, tuple(goals)


def _draw_objects(
    task: HomeTask, surfaces: Surfaces, starts: Sequence[Receptacle], rng: np.random.Generator
) -> tuple[Placement, ...] | None:
    rules: list[tuple[PlacementRule, Receptacle | None]] = []
    rules += [(target.start, start) for target, start in zip(task.targets, starts, strict=True)]
    rules += [(rule, None) for number, rule in task.clutter for _ in range(number)]
    objects = []
    for rule, fixed in rules:
        placement = _draw_object(surfaces, rule, fixed, rng)
        if placement is None:
            return None
        surfaces.add(placement)
        objects.append(placement)
    return tuple(objects)


def _draw_object(
    surfaces: Surfaces, rule: PlacementRule, fixed: Receptacle | None, rng: np.random.Generator
) -> Placement | None:
    for _ in range(PAIRINGS):
        kind = rule.objects[int(len(rule.objects) * rng.random())]
        receptacle = fixed or _any_of(surfaces.apartment, rule, rng)
        placement = surfaces.draw(kind, receptacle, rng, rule.ratio, anywhere=fixed is None)
        if placement is not None:
            return placement
    return None


def _any_of(apartment: Apartment, rule: PlacementRule, rng: np.random.Generator) -> Receptacle:
    """Return one of the receptacles a rule allows, each instance as likely as any other."""
    candidates = [r for name in rule.receptacles for r in apartment.receptacles_named(name)]
    return candidates[int(len(candidates) * rng.random())]
