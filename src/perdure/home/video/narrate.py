"""Captions of a running episode: the skill, its number in the plan, the stages reached."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from perdure.home.agents.actor import Actor
from perdure.home.benchmark.episodes import Episode
from perdure.home.benchmark.tasks import NOTHING, SOMETHING_ELSE, WorldFacts, latch
from perdure.home.sim.arrays import FloatArray, IntArray
from perdure.home.sim.objects import short_name
from perdure.home.sim.world import CONTROL_HZ, PrivilegedState, World
from perdure.home.skills import Progress, Skill


@dataclass(frozen=True)
class Caption:
    """The caption of one step of an episode."""

    seconds: float
    """Simulated time since the start."""
    number: int
    """Number of plan steps that have begun."""
    total: int
    """Number of plan steps."""
    words: str
    """Such as `pick the bowl`."""
    stages: tuple[tuple[str, bool], ...]
    """Names of the stages, and whether each was reached."""


class Narrator:
    """Keeps the caption of one episode on lane 0 of an executor up to date."""

    def __init__(self, episode: Episode) -> None:
        """Begin before the first step."""
        self.episode = episode
        self._reached = np.zeros(len(episode.home_task.stages), dtype=bool)
        self._step = self._number = 0

    def track(self, actors: Mapping[str, Actor]) -> dict[str, Actor]:
        """Return the same actors, wrapped so that the narrator is notified when a skill begins."""
        return {name: _TrackedActor(actor, self) for name, actor in actors.items()}

    def begin_skill(self) -> None:
        """Count the next step of the plan as begun."""
        self._number += 1

    def after_step(self, world: World) -> None:
        """Update clock and stages after a control step."""
        episode = self.episode
        self._reached = latch(episode.home_task, self._reached, _facts(world, episode))
        self._step += 1

    @property
    def skill(self) -> str:
        """The running skill."""
        return self.episode.home_task.skills[max(self._number - 1, 0)].skill

    def caption(self) -> Caption:
        """Return the current caption."""
        task = self.episode.home_task
        stages = tuple((stage.name, bool(done)) for stage, done in zip(task.stages, self._reached, strict=True))
        return Caption(self._step / CONTROL_HZ, self._number, len(task.skills), self._words(), stages)

    def _words(self) -> str:
        if not self._number:
            return "start"
        step = self.episode.home_task.skills[self._number - 1]
        what = short_name(self.episode.objects[step.target].kind)
        if step.skill == "reset_arm":
            return "reset the arm"
        if step.skill == "navigate":
            return f"navigate to {_verb(step.toward or 'pick')} {_thing(step.toward or 'pick', what)}"
        return f"{_verb(step.skill)} {_thing(step.skill, what)}"


class _TrackedActor:
    """An actor that notifies the narrator when its skill begins."""

    def __init__(self, actor: Actor, narrator: Narrator) -> None:
        self._actor, self._narrator = actor, narrator

    @property
    def sees(self) -> bool:
        """See `Actor.sees`."""
        return self._actor.sees

    def overtime(self, lane: int) -> bool:
        """See `Actor.overtime`."""
        return self._actor.overtime(lane)

    def begin(self, world: World, lane: int, skill: Skill) -> None:
        """See `Actor.begin`."""
        self._narrator.begin_skill()
        self._actor.begin(world, lane, skill)

    def act(
        self, world: World, lanes: IntArray, skill: Skill, state: PrivilegedState, progress: Progress
    ) -> FloatArray:
        """See `Actor.act`."""
        return self._actor.act(world, lanes, skill, state, progress)


def _facts(world: World, episode: Episode) -> WorldFacts:
    """Return the facts of lane 0 that the task's predicates need."""
    lane, targets = world.lane(0), len(episode.goals)
    full = lane.held >= 0 or lane.held_link >= 0
    held = lane.held if 0 <= lane.held < targets else SOMETHING_ELSE if full else NOTHING
    containers = [episode.container(target) for target in range(targets)]
    drawer = next((each for each in containers if each is not None and each != "top_door"), None)
    opened = dict(zip(lane.scene.links, lane.links, strict=True))
    return WorldFacts(
        world.objects(np.array([0]), targets)[0][0, :, :3],
        episode.goal_positions,
        np.array(held),
        np.array(opened[drawer] if drawer else 0.0),
        np.array(opened["top_door"]),
    )


def _verb(skill: str) -> str:
    return skill.partition("_")[0]


def _thing(skill: str, what: str) -> str:
    kind = skill.partition("_")[2]
    return f"the {kind or what}"
