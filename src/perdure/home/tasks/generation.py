"""Generate episodes.

The rules are those of habitat-lab's generator (`habitat/datasets/rearrange/rearrange_generator.py`) with M3's
configurations: receptacles of targets and goals are drawn first; then objects are placed, targets before clutter, each
uniform on a receptacle drawn uniformly among those allowed, upright with a random heading; then everything settles for
5 s, and an episode in which anything moved by more than 0.1 m is rejected; then goals are drawn, free of every object,
and an episode with a goal closer than 0.5 m to its object's start is rejected. Targets and goals lie within 1.5 m of
where the robot can stand.

Two additions (our choice): in TidyHouse too the robot must be able to stand near, and no goal overlaps another.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from perdure.errors import PerdureError
from perdure.home.sim import occupancy
from perdure.home.sim.apartments import build_apartment, make_apartment, split_apartments
from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.objects import Placement, add_object, get_kind
from perdure.home.sim.occupancy import FreeSpace, free_space
from perdure.home.sim.pieces import Apartment, Receptacle
from perdure.home.tasks.episodes import Episode, EpisodeSet
from perdure.home.tasks.tasks import TASKS, HomeTask, PlacementRule, get_task

PER_APARTMENT = {"train": 100, "val": 5, "eval": 5, "eval-2": 5}
"""Episodes in each apartment of a split, as in M3."""
_EPISODES = 1000
APART = 0.5
"""Smallest distance in [m] from a target's start to its goal."""
PAIRINGS = 100
"""Pairs of object and receptacle tried for one object."""
Refusal = Callable[[str], None]


def generate_episodes(
    task: str, split: str, seed: int = 0, refused: Refusal = lambda reason: None, per_apartment: int | None = None
) -> EpisodeSet:
    """Return all episodes of a task and split (a key of `PER_APARTMENT`); another seed gives other episodes.

    `refused` is called with the reason whenever a draw is rejected. `per_apartment`: M3's number when None.
    """
    apartments = split_apartments(split)
    count = PER_APARTMENT[split] if per_apartment is None else per_apartment
    episodes = tuple(
        generate_episode(task, split, number * count + k, apartment, seed, refused)
        for number, apartment in enumerate(apartments)
        for k in range(count)
    )
    return EpisodeSet(task, split, {"seed": str(seed)}, episodes)


def generate_episode(
    task: str, split: str, index: int, apartment: tuple[int, int], seed: int = 0, refused: Refusal = lambda reason: None
) -> Episode:
    """Return one episode in the apartment (macro, micro); it depends on its arguments only, not on other episodes.

    `refused` is called with the reason whenever a draw is rejected.
    """
    home_task = get_task(task)
    home = make_apartment(*apartment)
    rng = np.random.Generator(np.random.PCG64([seed, list(TASKS).index(task), *apartment, index]))
    for _ in range(_EPISODES):
        drawn = _draw(home_task, home, rng)
        if not isinstance(drawn, str):
            return Episode(task, split, index, home.macro, home.micro, home.fingerprint, dict(home_task.opened), *drawn)
        refused(drawn)
    raise PerdureError(f"no episode {index} of {task} in {home.name}: {_EPISODES} draws were rejected")


def _draw(
    task: HomeTask, apartment: Apartment, rng: np.random.Generator
) -> tuple[tuple[Placement, ...], tuple[Placement, ...]] | str:
    """Return objects and goals, or the reason why this draw is rejected."""
    space = free_space(apartment, task.opened)
    surfaces = Surfaces(apartment, space)
    starts = [_any_of(apartment, target.start, rng) for target in task.targets]
    ends = [_any_of(apartment, target.goal, rng) for target in task.targets]
    drawn = _draw_objects(task, surfaces, starts, rng)
    if drawn is None:
        return "no room for the objects"
    objects, moved, _ = settle(apartment, dict(task.opened), drawn)
    if (moved > MOST_SETTLING).any():
        return "an object was not stable"
    after = Surfaces(apartment, space)
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


TRIES = 50
"""Places tried for one object on one receptacle (habitat-lab, `samplers/object_sampler.py`)."""
NAVIGABLE_WITHIN = 1.5
"""Largest horizontal distance in [m] from an object or goal to where the robot can stand (`nav_to_min_distance`)."""
GAP = 0.005
"""Smallest gap between two objects on a receptacle in [m] (our choice)."""
UPRIGHT = 0.99
"""Height of the z axis of an object that stands, lower when it lies or leans."""
LIFT = 0.001
"""Height above the surface at which an object is put before it settles in [m] (our choice)."""


@dataclass
class Surfaces:
    """Objects placed on receptacles so far: footprints (x, y, half x, half y, yaw) by the receptacle's unique name."""

    apartment: Apartment
    space: FreeSpace
    taken: dict[str, list[FloatArray]] = field(default_factory=dict)

    def footprint(self, kind: str, x: float, y: float, yaw: float) -> FloatArray:
        """Return the rectangle an upright object covers in the room. Shape (5,)."""
        half_x, half_y, _ = get_kind(kind).half
        return np.array([x, y, half_x, half_y, yaw])

    def add(self, placement: Placement) -> None:
        """Add an object to its receptacle. One that does not stand upright takes a square of its longest side."""
        w, x, y, z = placement.quaternion
        shape = self.footprint(placement.kind, *placement.position[:2], 2.0 * math.atan2(z, w))
        if 1.0 - 2.0 * (x * x + y * y) < UPRIGHT:
            shape[2:4] = max(get_kind(placement.kind).half)
        self.taken.setdefault(placement.receptacle, []).append(shape)

    def draw(
        self,
        kind: str,
        receptacle: Receptacle,
        rng: np.random.Generator,
        ratio: Mapping[str, float],
        lift: float = LIFT,
        anywhere: bool = False,
    ) -> Placement | None:
        """Return a place for an upright object, uniform on a receptacle, None when none was found in 50 tries.

        Args:
            kind: YCB name.
            receptacle: Where to put it.
            rng: The random generator.
            ratio: Share of the receptacle's length and width to use, by receptacle name.
            lift: Distance of its lowest point from the surface in [m].
            anywhere: Whether the robot need not be able to stand near it.
        """
        half = get_kind(kind).half[2]
        if 2.0 * half + lift >= receptacle.headroom:
            return None
        share = ratio.get(receptacle.name, 1.0)
        for _ in range(TRIES):
            across, along, turn = rng.random(3)
            offset = share * np.array([2.0 * across - 1.0, 2.0 * along - 1.0]) * receptacle.half
            yaw = 2.0 * math.pi * turn
            x, y, height = self.apartment.surface_to_room(receptacle, offset)
            shape = self.footprint(kind, float(x), float(y), yaw)
            others = self.taken.get(receptacle.unique_name, [])
            if others and occupancy.overlap(shape[None], np.stack(others), GAP).any():
                continue
            if not anywhere and self.space.nearest(np.array([[x, y]]))[1][0] >= NAVIGABLE_WITHIN:
                continue
            position = (round(float(x), 4), round(float(y), 4), round(float(height) + half + lift, 4))
            quaternion = (round(math.cos(yaw / 2), 5), 0.0, 0.0, round(math.sin(yaw / 2), 5))
            return Placement(kind, position, quaternion, receptacle.unique_name)
        return None


SECONDS = 5.0
"""Time to settle in [s] (habitat-lab, `rearrange_generator.py`)."""
MOST_SETTLING = 0.1
"""An object that moved farther than this in [m] was not stable (the same)."""
TIMESTEP = 1.0 / 240.0
"""Physics step in [s]."""


def settle(
    apartment: Apartment, opened: dict[str, float], placements: Sequence[Placement], seconds: float = SECONDS
) -> tuple[tuple[Placement, ...], FloatArray, FloatArray]:
    """Simulate objects in an apartment for some seconds.

    Args:
        apartment: Where they are.
        opened: Joint positions of doors and drawers by link name.
        placements: The objects.
        seconds: For how long.

    Returns:
        The objects where they came to rest (rounded to 0.1 mm), how far each moved in [m] and how fast it still is in
        [m/s]. Shapes (objects,).
    """
    import mujoco

    spec = build_apartment(apartment, visuals=False)
    spec.option.timestep = TIMESTEP
    names = [f"object_{k}" for k in range(len(placements))]
    for name, placement in zip(names, placements, strict=True):
        add_object(spec, placement, name, visuals=False)
    model = spec.compile()
    data = mujoco.MjData(model)
    for link, q in opened.items():
        data.joint(apartment.articulation(link).joint).qpos = q
    mujoco.mj_step(model, data, nstep=round(seconds / TIMESTEP))
    mujoco.mj_forward(model, data)
    start = np.array([placement.position for placement in placements])
    bodies = [data.body(name) for name in names]
    moved = np.linalg.norm([body.xpos for body in bodies] - start, axis=1)
    speed = np.linalg.norm([body.cvel[3:] for body in bodies], axis=1)
    rested = (_rested(p, body.xpos, body.xquat) for p, body in zip(placements, bodies, strict=True))
    return tuple(rested), moved, speed


def _rested(placement: Placement, position: FloatArray, quaternion: FloatArray) -> Placement:
    x, y, z = (round(float(value), 4) for value in position)
    q0, q1, q2, q3 = (round(float(value), 5) + 0.0 for value in quaternion)
    return Placement(placement.kind, (x, y, z), (q0, q1, q2, q3), placement.receptacle)
