"""A protocol: task, release strategy, split, numbers of episodes and seeds, and policies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal, Self, get_args

from perdure.home.benchmark.episodes import load_episodes
from perdure.home.benchmark.tasks import SkillName, get_task
from perdure.home.errors import HomeError
from perdure.home.evaluate.execute import ExecutorOptions
from perdure.home.evaluate.protocol.naming import strategy_name
from perdure.home.evaluate.protocol.policies import ORACLE, SkillPolicy, choose_policies
from perdure.home.evaluate.protocol.release_choice import ReleaseChoice, read_release
from perdure.home.sim.world import SceneOptions
from perdure.home.skills import Skill, get_skill

Vary = Literal["all", "place"]
"""Whose policy is that of the training seed: every skill's, or that of place alone; the others are then of seed 0."""


@dataclass(frozen=True)
class EvaluationProtocol:
    """What to run."""

    task: str
    place: str = "rl"
    """See `read_release`."""
    split: str = "val"
    episodes: int = 100
    train_seeds: int = 1
    eval_seeds: int = 1
    vary: Vary = "all"
    policies: Mapping[str, str] = field(default_factory=dict)
    """See `choose_policies`."""
    options: ExecutorOptions = field(default_factory=ExecutorOptions)

    def __post_init__(self) -> None:
        """Whatever is no task, split, strategy or count raises HomeError."""
        count = len(load_episodes(self.task, self.split))
        for name, value, most in (("episodes", self.episodes, count), ("train_seeds", self.train_seeds, None)):
            if value < 1 or (most is not None and value > most):
                raise HomeError(f"{name} must be {'1 or more' if most is None else f'1 to {most}'}, not {value}")
        if self.eval_seeds < 1:
            raise HomeError(f"eval_seeds must be 1 or more, not {self.eval_seeds}")
        if self.vary not in get_args(Vary):
            raise HomeError(f"vary must be one of {', '.join(get_args(Vary))}, not {self.vary!r}")
        _ = self.release

    @property
    def release(self) -> ReleaseChoice:
        """The meaning of `place`."""
        return read_release(self.place)

    @property
    def name(self) -> str:
        """How logs and figures call it, see `strategy_name`."""
        return strategy_name(self.place, self.options)

    @property
    def folder(self) -> str:
        """Where the store keeps all of it, such as `set_table/val/ik`."""
        return f"{self.task}/{self.split}/{self.name.replace('+', '-plus').replace(' ', '-')}"

    def assignment(self, train_seed: int) -> dict[SkillName, SkillPolicy]:
        """Return the policy of each skill for a training seed; HomeError as for `choose_policies`."""
        everyone = choose_policies(self.task, 0 if self.vary == "place" else train_seed, self.policies, self.release)
        if self.vary == "place" and train_seed > 0:
            others: dict[str, str] = {skill: ORACLE for skill in everyone if skill != "place"}
            alone = choose_policies(self.task, train_seed, {**self.policies, **others}, self.release)
            everyone["place"] = alone["place"]
        return everyone

    def skills(self) -> dict[str, Skill]:
        """Return the skills of the task's plan."""
        names: set[str] = {step.skill for step in get_task(self.task).skills}
        return {name: get_skill(name, **(self.release.options if name == "place" else {})) for name in names}

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values for another process, see `from_json`."""
        return asdict(self)

    @classmethod
    def from_json(cls, settings: Mapping[str, Any]) -> Self:
        """Return the protocol that `to_json` described, also after it has been text."""
        options = dict(settings["options"])
        scene = SceneOptions(**options.pop("scene"))
        return cls(**{**settings, "options": ExecutorOptions(**options, scene=scene)})
