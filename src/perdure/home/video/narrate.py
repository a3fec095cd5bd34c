"""Captions of a running episode: the skill, its number in the plan, the stages reached."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perdure.home.benchmark.episodes import Episode
from perdure.home.benchmark.tasks import WorldFacts, latch
from perdure.home.evaluate.execute.executor import Running
from perdure.home.evaluate.execute.recorder import held_target, opened
from perdure.home.sim.objects import short_name
from perdure.home.sim.world import CONTROL_HZ, VectorSimulator


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

    def __init__(self, episode: Episode, begun: int = 0) -> None:
        """Begin before the first step, or after `begun` steps of the plan."""
        self.episode = episode
        self._reached = np.zeros(len(episode.home_task.stages), dtype=bool)
        self._step, self._number = 0, begun

    def after_step(self, world: VectorSimulator, running: Running) -> None:
        """Update clock, skill and stages after a control step."""
        lanes, targets = np.array([0]), len(self.episode.goals)
        facts = WorldFacts(
            world.objects(lanes, targets)[0][0, :, :3],
            self.episode.goal_positions,
            held_target(world.sense(lanes), targets)[0],
            *opened(world, lanes, [running.doors])[0],
        )
        self._reached = latch(self.episode.home_task, self._reached, facts)
        self._number, self._step = running.begun, self._step + 1

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


def _verb(skill: str) -> str:
    return skill.partition("_")[0]


def _thing(skill: str, what: str) -> str:
    kind = skill.partition("_")[2]
    return f"the {kind or what}"
