"""What a home environment is about, checked before anything is built."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from perdure.home.benchmark.episodes import Episode, load_episodes
from perdure.home.benchmark.tasks import get_task
from perdure.home.errors import HomeError
from perdure.home.sim.apartments import split_apartments
from perdure.home.sim.world import PHYSICS_HZ, Rolling, SceneOptions
from perdure.home.skills import Skill, get_skill
from perdure.home.skills.starts import ANY_HEADING, STARTS, Draw, train_pool


@dataclass(frozen=True)
class SkillEnvOptions:
    """Which skill is learned, and on what."""

    skill: str = "place"
    task: str = "tidy_house"
    split: str = "train"
    """`train`: generated episodes, see `episodes`; `val` and `eval`: the published ones."""
    targets: tuple[int, ...] | int | None = None
    """Targets of the task it is about (or the only one), drawn uniformly; all that the skill is used for when None."""
    delta: int = 1
    """For place: how many steps the object must stay."""
    limited_to: int | None = None
    """For place: control steps it may last; 200, with delta 200 + delta, when None."""
    any_heading: bool = False
    """For place: whether half the robots begin with any heading; else, as in M3, all face the goal."""
    clutter: bool = False
    """Whether objects that are no targets are there."""
    physics_hz: int = PHYSICS_HZ
    rolling: Rolling = "friction"
    """What stops objects that roll, see `SceneOptions`."""
    episodes: int | None = None
    """How many episodes are used; 64 of `train` (one per apartment), all published ones when None."""

    def __post_init__(self) -> None:
        """Whatever does not fit together raises HomeError."""
        if self.skill not in STARTS:
            raise HomeError(f"there is no environment for the skill {self.skill!r}; there are {', '.join(STARTS)}")
        if self.delta != 1 and self.skill != "place":
            raise HomeError(f"delta is about place; {self.skill} has none, so it must stay 1, not {self.delta}")
        if self.limited_to is not None and self.skill != "place":
            raise HomeError(f"limited_to is about place; {self.skill} has none, so it must be None")
        if self.any_heading and self.skill not in ANY_HEADING:
            raise HomeError(f"any_heading is about {', '.join(ANY_HEADING)}; {self.skill} has no such starts")
        if self.episodes is not None and self.episodes < 1:
            raise HomeError(f"episodes must be at least 1, not {self.episodes}")
        split_apartments(self.split)
        used = self._used()
        if not used:
            raise HomeError(f"{self.task} never uses the skill {self.skill}")
        if not self.chosen_targets or set(self.chosen_targets) - set(used):
            raise HomeError(f"targets of {self.skill} in {self.task} are some of {used}, not {self.targets}")
        _ = self.scene, self.make_skill()

    @property
    def chosen_targets(self) -> tuple[int, ...]:
        """The targets among which is drawn."""
        if self.targets is None:
            return self._used()
        return (self.targets,) if isinstance(self.targets, int) else tuple(self.targets)

    @property
    def scene(self) -> SceneOptions:
        """How scenes are built, up to the target."""
        return SceneOptions(physics_hz=self.physics_hz, clutter=self.clutter, rolling=self.rolling)

    @property
    def draw(self) -> Draw:
        """Where it begins."""
        return (ANY_HEADING if self.any_heading else STARTS)[self.skill]

    def make_skill(self) -> Skill:
        """The skill."""
        given = {"delta": self.delta, "limited_to": self.limited_to} if self.skill == "place" else {}
        return get_skill(self.skill, **given)

    def load(self) -> tuple[Episode, ...]:
        """The episodes among which is drawn."""
        if self.split == "train":
            return train_pool(self.task, **({} if self.episodes is None else {"count": self.episodes})).episodes
        return load_episodes(self.task, self.split).episodes[: self.episodes]

    def _used(self) -> tuple[int, ...]:
        """Targets for which the task's plan uses the skill."""
        return tuple(sorted({step.target for step in get_task(self.task).skills if step.skill == self.skill}))


def checked_options(options: Mapping[str, Any]) -> SkillEnvOptions:
    """Options by name; HomeError for names that do not exist."""
    known = [each.name for each in fields(SkillEnvOptions)]
    unknown = sorted(set(options) - set(known))
    if unknown:
        raise HomeError(f"no option is named {', '.join(unknown)}; there are {', '.join(known)}")
    return SkillEnvOptions(**options)
