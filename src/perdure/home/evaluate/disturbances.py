"""Disturbances of a home: what `perdure home run --disturb perception:0.02 bump:0.1` does to an episode.

A kind is a subclass of `HomeEffect`, found by its name as soon as it is defined, also in another package (see
`perdure.registry`). What an episode meets depends on the evaluation seed, the episode and the disturbance alone. The
judge sees the home as it is.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from perdure.errors import PerdureError, lookup
from perdure.home.evaluate.strategy import CALM
from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.scene import CONTROL_HZ
from perdure.home.sim.sensors import PrivilegedState, SkillGoal
from perdure.home.sim.simulator import Simulator
from perdure.home.tasks.episodes import Episode, episode_hash
from perdure.home.tasks.tasks import AT, Verb, WorldFacts
from perdure.registry import Registered


@dataclass(frozen=True, order=True)
class HomeDisturbance:
    """One way to disturb the episodes of a home, at one level.

    Raises:
        PerdureError: If there is no such kind, or its level is out of range.
    """

    name: str
    """Of a subclass of `HomeEffect`."""
    level: float

    def __post_init__(self) -> None:
        most = self.kind.most
        if not 0.0 < self.level <= most:
            raise PerdureError(f"the level of {self.name} must be above 0 and at most {most:g} m, got {self.level}")

    @property
    def kind(self) -> type[HomeEffect]:
        """The class of that name."""
        return lookup(HomeEffect.kinds(), self.name, "disturbance of a home")

    @property
    def label(self) -> str:
        """The text that `parse_home_disturbances` reads, such as ``bump:0.1``."""
        return f"{self.name}:{self.level:g}"

    def effect(self, episode: Episode, eval_seed: int) -> HomeEffect:
        """Return what it does to an episode."""
        # By its content: errands of one home have one name.
        key = [eval_seed, zlib.crc32(f"{self.name} {episode_hash(episode)}".encode())]
        return self.kind(self.level, episode, np.random.default_rng(key))


def parse_home_disturbances(texts: Sequence[str]) -> tuple[HomeDisturbance, ...]:
    """Return the disturbances of texts such as ``bump:0.1``, in one order; none for "none".

    Raises:
        PerdureError: If a text names none, a level is out of range, or a kind is named twice.
    """
    if tuple(texts) in ((), (CALM,)):
        return ()
    found = []
    for text in texts:
        name, _, level = text.partition(":")
        try:
            number = float(level)
        except ValueError:
            number = math.nan
        if math.isnan(number):
            raise PerdureError(f"a disturbance of a home is written name:level, such as bump:0.1, not {text!r}")
        found.append(HomeDisturbance(name, number))
    if len({each.name for each in found}) < len(found):
        raise PerdureError(f"one kind of disturbance is named twice: {home_labels(found)}")
    return tuple(sorted(found))


def home_labels(disturbances: Sequence[HomeDisturbance]) -> str:
    """Return how logs and tables name disturbances that act together: "bump:0.1 perception:0.02", or "none"."""
    return " ".join(each.label for each in disturbances) or CALM


class HomeEffect(Registered):
    """What a disturbance does to one episode; a subclass overrides the methods in which it acts."""

    words: ClassVar[str]
    """What happens at a `level` in [m]."""
    example: ClassVar[float]
    """A level that is worth trying."""
    most: ClassVar[float] = 1.0
    """Largest level."""

    def __init__(self, level: float, episode: Episode, rng: np.random.Generator) -> None:
        self.level = level
        self.episode = episode
        self.rng = rng
        self.prepare()

    def prepare(self) -> None:
        """Draw what does not change during the episode."""

    def perceive_facts(self, facts: WorldFacts) -> WorldFacts:
        """Return the facts, without leading axes, that the planner gets."""
        return facts

    def perceive_goal(self, goal: SkillGoal) -> SkillGoal:
        """Return the skill goal that policies get."""
        return goal

    def perceive_state(self, state: PrivilegedState) -> PrivilegedState:
        """Return the state, one row, that policies get."""
        return state

    def after_step(self, simulator: Simulator) -> None:
        """Change the home after a control step."""


class Perception(HomeEffect):
    """See `words`. The errors of an object, its goal and a handle do not depend on each other."""

    name = "perception"
    words = (
        "objects, goals and handles are perceived beside where they are, by an error that is constant during an "
        "episode: normal, with a standard deviation of `level` m an axis"
    )
    example = 0.02
    most = 0.5

    def prepare(self) -> None:
        """Draw the errors of all targets, goals and handles."""
        targets = len(self.episode.goals)
        self._objects = self._draw(targets)
        self._goals = self._draw(targets)
        self._handles = self._draw(len(self.episode.apartment().articulations))

    def _draw(self, count: int) -> FloatArray:
        return self.level * self.rng.standard_normal((count, 3))

    def perceive_facts(self, facts: WorldFacts) -> WorldFacts:
        """See `HomeEffect.perceive_facts`."""
        return replace(
            facts,
            object_positions=facts.object_positions + self._objects,
            goal_positions=facts.goal_positions + self._goals,
        )

    def perceive_goal(self, goal: SkillGoal) -> SkillGoal:
        """See `HomeEffect.perceive_goal`."""
        error = self._objects[goal.target]
        if goal.link >= 0:
            error = self._handles[goal.link]
        elif goal.toward == Verb.PLACE:
            error = self._goals[goal.target]
        x, y, z = (np.asarray(goal.goal) + self._goals[goal.target]).tolist()
        aim_x, aim_y, aim_z = (np.asarray(goal.aim) + error).tolist()
        return replace(goal, goal=(x, y, z), aim=(aim_x, aim_y, aim_z))

    def perceive_state(self, state: PrivilegedState) -> PrivilegedState:
        """See `HomeEffect.perceive_state`."""
        seen = state.object + self._objects[int(state.target[0])]
        handle = state.handle
        link = int(state.link[0])
        if link >= 0:
            handle = handle + self._handles[link]
        return replace(state, object=seen, handle=handle)


RESTED = CONTROL_HZ
"""Control steps that a target has been at its goal, out of the hand, before it is bumped."""
DIRECTIONS = 16
"""Directions in which a bumped object may go; the first free one after a random one is taken."""
OVERLAP = 0.002
"""Penetration in [m] beyond which a bumped object would be inside something."""


class Bump(HomeEffect):
    """See `words`. Nothing happens where it could go nowhere."""

    name = "bump"
    words = "one target, drawn at random, is moved by `level` m on its surface, once, a second after it was placed"
    example = 0.1

    def prepare(self) -> None:
        """Draw the target and a direction."""
        self.target = int(self.rng.integers(len(self.episode.goals)))
        self._first = float(self.rng.uniform(0.0, 2.0 * np.pi))
        self._rested = 0
        self._over = False

    def after_step(self, simulator: Simulator) -> None:
        """See `HomeEffect.after_step`."""
        if self._over:
            return
        middle = simulator.object(self.target)[0][:3]
        away = float(np.linalg.norm(middle - self.episode.goal_positions[self.target]))
        placed = away <= AT and simulator.held != self.target
        self._rested = self._rested + 1 if placed else 0
        if self._rested >= RESTED:
            self._over = True
            self._move(simulator)

    def _move(self, simulator: Simulator) -> None:
        """Move the target in the first direction in which it stays on its surface and touches nothing else."""
        pose, _ = simulator.object(self.target)
        before = pose.copy()
        speed = simulator.scene.object_qvel[self.target]
        simulator.search_all()
        for angle in self._first + np.arange(DIRECTIONS) * 2.0 * np.pi / DIRECTIONS:
            pose[:2] = before[:2] + self.level * np.array([np.cos(angle), np.sin(angle)])
            simulator.forward()
            if self._is_on_surface(pose[:3]) and not _overlaps(simulator, self.target):
                simulator.qvel[speed : speed + 6] = 0.0
                return
        pose[:] = before
        simulator.forward()

    def _is_on_surface(self, point: FloatArray) -> bool:
        """Return whether a point of the room, shape (3,), is above the surface of the target's goal."""
        apartment = self.episode.apartment()
        receptacle = apartment.receptacle(self.episode.goals[self.target].receptacle)
        pose = apartment.piece(receptacle.piece).pose
        local = pose.to_local(point) - pose.to_local(apartment.surface_to_room(receptacle, np.zeros(2)))
        return bool((np.abs(local[:2]) <= receptacle.half).all())


def _overlaps(simulator: Simulator, number: int) -> bool:
    """Return whether an object is inside something."""
    contact = simulator.data.contact
    ours = np.isin(contact.geom, simulator.scene.object_geoms[number]).any(axis=1)
    return bool((contact.dist[ours] < -OVERLAP).any())
