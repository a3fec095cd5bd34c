"""The options of a skill environment, checked before anything is built."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any, get_args

from perdure.home.benchmark.episodes import Episode, load_episodes
from perdure.home.benchmark.tasks import TASKS, HomeTask, get_task
from perdure.home.errors import HomeError
from perdure.home.sim.apartments import SPLITS
from perdure.home.sim.world import PHYSICS_HZ, Rolling, SceneOptions
from perdure.home.sim.world.scene import SERVO_HZ
from perdure.home.skills.gym.checks import PythonFlag, check_kinds, plain
from perdure.home.skills.registry import SKILLS, choices, get_skill, learned_skills
from perdure.home.skills.skill import Skill
from perdure.home.skills.starts import train_pool
from perdure.schema import Choice, Items, Kind, Maybe, Text, Whole

SKILL_OPTIONS = ("delta", "limited_to", "any_heading")
"""Options that are fields of a skill."""
COUNT = Whole(1, 1_000_000)
KINDS: Mapping[str, Kind] = {
    "skill": Text(),
    "task": Choice(tuple(TASKS)),
    "split": Choice(tuple(SPLITS)),
    "targets": Maybe(Items(Whole(0, 100))),
    "delta": COUNT,
    "limited_to": Maybe(COUNT),
    "any_heading": PythonFlag(),
    "clutter": PythonFlag(),
    "physics_hz": Whole(SERVO_HZ, 100_000),
    "rolling": Choice(get_args(Rolling)),
    "episodes": Maybe(COUNT),
}
"""The kind of every option."""


@dataclass(frozen=True)
class SkillEnvOptions:
    """The skill, its task and the world of an environment."""

    skill: str = "place"
    task: str = "tidy_house"
    split: str = "train"
    """`train`: generated episodes, see `episodes`; `val` and `eval`: the published episodes."""
    targets: tuple[int, ...] | int | None = None
    """The targets to draw from, uniformly; all that need the skill when None."""
    delta: int = 1
    """See `Place`."""
    limited_to: int | None = None
    """See `Place`."""
    any_heading: bool = False
    """See `Place`."""
    clutter: bool = False
    """Whether objects that are no targets are in the scene."""
    physics_hz: int = PHYSICS_HZ
    rolling: Rolling = "friction"
    """What stops rolling objects, see `SceneOptions`."""
    episodes: int | None = None
    """Number of episodes; when None 64 of `train`, one for each apartment, or all published ones."""

    def __post_init__(self) -> None:
        """Raise HomeError for options that do not exist or do not fit together."""
        for name, value in vars(self).items():
            object.__setattr__(self, name, plain(value))
        if self.targets is not None:
            given = self.targets if isinstance(self.targets, Iterable) else (self.targets,)
            object.__setattr__(self, "targets", tuple(map(plain, given)))
        check_kinds(KINDS, vars(self))
        if self.skill not in learned_skills():
            raise HomeError(f"no environment for the skill {self.skill!r}; {choices(self.skill, learned_skills())}")
        for each in fields(self):
            owners = [name for name, kind in SKILLS.items() if each.name in option_names(kind)]
            if each.name in SKILL_OPTIONS and self.skill not in owners and getattr(self, each.name) != each.default:
                raise HomeError(
                    f"{each.name} is an option of {', '.join(owners)}, not of {self.skill}; leave it at {each.default}"
                )
        published = 0 if self.split == "train" else len(load_episodes(self.task, self.split).episodes)
        if published and self.episodes is not None and self.episodes > published:
            raise HomeError(f"episodes must be 1 to {published}, all of {self.split}, not {self.episodes}")
        used = targets_of(self.skill, get_task(self.task))
        if not used:
            raise HomeError(f"{self.task} never uses the skill {self.skill}")
        if not self.chosen_targets or set(self.chosen_targets) - set(used):
            raise HomeError(f"targets of {self.skill} in {self.task} are some of {used}, not {self.targets}")
        _ = self.scene, self.make_skill()

    @property
    def chosen_targets(self) -> tuple[int, ...]:
        """Return the targets to draw from."""
        if self.targets is None:
            return targets_of(self.skill, get_task(self.task))
        assert not isinstance(self.targets, int), "made a tuple at construction"
        return self.targets

    @property
    def scene(self) -> SceneOptions:
        """Return how scenes are built; the target is added for each."""
        return SceneOptions(physics_hz=self.physics_hz, clutter=self.clutter, rolling=self.rolling)

    def make_skill(self) -> Skill:
        """Return the skill with its own options."""
        own = option_names(SKILLS[self.skill])
        return get_skill(self.skill, **{name: getattr(self, name) for name in SKILL_OPTIONS if name in own})

    def check_step_limit(self, max_episode_steps: int | None) -> None:
        """Raise HomeError for a limit in which the object cannot stay for `delta` steps."""
        if max_episode_steps is not None and max_episode_steps < self.delta:
            raise HomeError(
                f"no episode of {max_episode_steps} steps can succeed with delta={self.delta}; "
                f"also give max_episode_steps={self.make_skill().limit}"
            )

    def load(self) -> tuple[Episode, ...]:
        """Return the episodes to draw from."""
        if self.split == "train":
            return train_pool(self.task, **({} if self.episodes is None else {"count": self.episodes})).episodes
        return load_episodes(self.task, self.split).episodes[: self.episodes]


def option_names(kind: type[Skill]) -> set[str]:
    """Return the names of a skill's own options."""
    return {each.name for each in fields(kind)}


def targets_of(skill: str, task: HomeTask) -> tuple[int, ...]:
    """Return the targets for which a task's plan uses a skill; all targets for a skill that no task uses."""
    if not any(step.skill == skill for each in TASKS.values() for step in each.skills):
        return tuple(range(len(task.targets)))
    return tuple(sorted({step.target for step in task.skills if step.skill == skill}))


def checked_options(options: Mapping[str, Any]) -> SkillEnvOptions:
    """Return options by name; raise HomeError for unknown names."""
    known = [each.name for each in fields(SkillEnvOptions)]
    for name in sorted(set(options) - set(known)):
        raise HomeError(f"no option is named {name!r}; {choices(name, known)}")
    return SkillEnvOptions(**options)
