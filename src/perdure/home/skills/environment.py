"""Gymnasium environments of the skills: their options, the episodes they draw, one lane or many."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Any, Literal, get_args

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from perdure.envs.suites import VectorSuite
from perdure.errors import PerdureError, lookup
from perdure.home.sim.apartments import SPLITS
from perdure.home.sim.arrays import BoolArray, FloatArray, IntArray
from perdure.home.sim.scene import (
    FASTEST,
    LEVERS,
    MOST_ROLLING,
    PHYSICS_HZ,
    SERVO_HZ,
    GraspRule,
    Scene,
    SceneOptions,
    WorldOptions,
)
from perdure.home.sim.sensors import PrivilegedState
from perdure.home.sim.vector_simulator import VectorSimulator
from perdure.home.skills.registry import PREFIX, SKILLS, env_id, get_skill, learned_skills
from perdure.home.skills.skill import Skill, SkillProgress
from perdure.home.skills.starts import POOL, PlanStart, Start, begin, read_plan_starts, train_pool
from perdure.home.tasks.episodes import Episode, episode_scene, load_episodes
from perdure.home.tasks.planning import make_plan
from perdure.home.tasks.tasks import TASKS, HomeTask, get_task
from perdure.schema import Choice, Flag, Items, Kind, Maybe, Real, Text, Whole

COUNT = Whole(1, 1_000_000)
RETRY_WEIGHT = 5
"""How much more often recorded starts of further attempts are drawn: they are rare and hard (our choice)."""
OPTION_KINDS: Mapping[str, Kind] = {
    "skill": Text(),
    "task": Choice(tuple(TASKS)),
    "split": Choice(tuple(SPLITS)),
    "targets": Maybe(Items(Whole(0, 100))),
    "delta": COUNT,
    "actions": Choice(("joints", "hand")),
    "gentle": Flag(),
    "training": Flag(),
    "clutter": Flag(),
    "physics_hz": Whole(SERVO_HZ, 100_000),
    "rolling": Real(0.0, MOST_ROLLING),
    "grasp": Choice(get_args(GraspRule)),
    "base_speed": Real(0.0, FASTEST, above=True),
    "episodes": Maybe(COUNT),
}
"""The kind of every option."""
SKILL_OPTIONS = ("delta", "actions", "gentle")
"""Options that are fields of a skill."""


@dataclass(frozen=True)
class SkillEnvOptions:
    """The skill, its task and the world of an environment."""

    skill: str = "place"
    task: str = "tidy_house"
    split: str = "train"
    """`train`: generated episodes, see `episodes`; `val`, `eval` and `eval-2`: the published episodes."""
    targets: tuple[int, ...] | int | None = None
    """The targets to draw from, uniformly; all that need the skill when None."""
    delta: int = 1
    """See `Place`."""
    actions: Literal["joints", "hand"] = "joints"
    """See `Place`."""
    gentle: bool = False
    """See `Place`."""
    training: bool = False
    """Whether each episode draws one of `LEVERS`, and half the start states of `train` are recorded (`PlanStart`)."""
    clutter: bool = False
    """Whether objects that are no targets are in the scene."""
    physics_hz: int = PHYSICS_HZ
    rolling: float = SceneOptions.rolling
    grasp: GraspRule = SceneOptions.grasp
    base_speed: float = SceneOptions.base_speed
    """See `WorldOptions`."""
    episodes: int | None = None
    """Number of episodes; when None 64 of `train`, one for each apartment, or all published ones."""

    def __post_init__(self) -> None:
        """Raise PerdureError for options that do not exist or do not fit together."""
        for name, value in vars(self).items():
            object.__setattr__(self, name, plain(value))
        if self.targets is not None:
            given = self.targets
            if not isinstance(given, Iterable):
                given = (given,)
            object.__setattr__(self, "targets", tuple(map(plain, given)))
        check_kinds(OPTION_KINDS, vars(self))
        lookup(dict.fromkeys(learned_skills()), self.skill, "skill with an environment")
        self._check_skill_options()
        self._check_episodes()
        self._check_targets()
        _ = self.scene
        self.make_skill()

    def _check_skill_options(self) -> None:
        """Raise PerdureError for an option of another skill."""
        for each in fields(self):
            owners = [name for name, kind in SKILLS.items() if each.name in kind.__dataclass_fields__]
            if each.name in SKILL_OPTIONS and self.skill not in owners and getattr(self, each.name) != each.default:
                raise PerdureError(
                    f"{each.name} is an option of {', '.join(owners)}, not of {self.skill}; leave it at {each.default}"
                )

    def _check_episodes(self) -> None:
        """Raise PerdureError for more episodes than are published."""
        if self.split == "train":
            return
        published = len(load_episodes(self.task, self.split).episodes)
        if self.episodes is not None and self.episodes > published:
            raise PerdureError(f"episodes must be 1 to {published}, all of {self.split}, not {self.episodes}")

    def _check_targets(self) -> None:
        """Raise PerdureError for targets for which the task does not use the skill."""
        used = targets_of(self.skill, get_task(self.task))
        if not used:
            raise PerdureError(f"{self.task} never uses the skill {self.skill}")
        if not self.chosen_targets or set(self.chosen_targets) - set(used):
            raise PerdureError(f"targets of {self.skill} in {self.task} are some of {used}, not {self.targets}")

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
        own = {each.name: getattr(self, each.name) for each in fields(WorldOptions) if hasattr(self, each.name)}
        return SceneOptions(clutter=self.clutter, **own)

    def make_skill(self) -> Skill:
        """Return the skill with its own options."""
        own = SKILLS[self.skill].__dataclass_fields__
        return get_skill(self.skill, **{name: getattr(self, name) for name in SKILL_OPTIONS if name in own})

    def load(self) -> tuple[Episode, ...]:
        """Return the episodes to draw from."""
        if self.split == "train":
            return train_pool(self.task, self.episodes or POOL).episodes
        return load_episodes(self.task, self.split).episodes[: self.episodes]


def checked_options(options: Mapping[str, Any]) -> SkillEnvOptions:
    """Return options by name; raise PerdureError for unknown names."""
    for name in sorted(options):
        lookup(SkillEnvOptions.__dataclass_fields__, name, "option")
    return SkillEnvOptions(**options)


def targets_of(skill: str, task: HomeTask) -> tuple[int, ...]:
    """Return the targets for which a task's plan uses a skill; all targets for a skill that no task uses."""
    if not any(step.skill == skill for each in TASKS.values() for step in make_plan(each)):
        return tuple(range(len(task.targets)))
    return tuple(sorted({step.target for step in make_plan(task) if step.skill == skill}))


def check_kinds(kinds: Mapping[str, Kind], values: Mapping[str, object]) -> None:
    """Raise PerdureError, with name, value and what is allowed, for a value that is not of its kind."""
    for name, kind in kinds.items():
        kind.check(plain(values[name]), name)


def plain(value: Any) -> Any:
    """Return a NumPy number or array as Python numbers; any other value itself."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    return value


class EpisodeSampler:
    """Draws the episodes of lanes. A draw depends on the lane's own generator only."""

    def __init__(self, options: SkillEnvOptions) -> None:
        """Load the episodes; those of `train` are generated the first time, which needs about a second for each."""
        self._options = options
        self.episodes = options.load()
        self._skill = options.make_skill()
        self._recorded: list[PlanStart] = []
        """Recorded start states, those of further attempts several times, so that they are drawn more often."""
        if options.training and options.split == "train":
            for row in read_plan_starts(options.task, options.skill):
                if row.episode < len(self.episodes) and row.step[1] in options.chosen_targets:
                    weight = RETRY_WEIGHT if row.attempt > 1 else 1
                    self._recorded += [row] * weight

    def begin(self, world: VectorSimulator, lane: int, rng: np.random.Generator) -> Episode:
        """Begin an episode in a lane and return it."""
        number = int(rng.integers(len(self.episodes)))
        targets = self._options.chosen_targets
        target = targets[int(rng.integers(len(targets)))]
        recorded = list[PlanStart]()
        if self._recorded and rng.random() < 0.5:
            recorded.append(self._recorded[int(rng.integers(len(self._recorded)))])
            number = recorded[0].episode
            target = recorded[0].step[1]
        episode = self.episodes[number]

        def draw(episode: Episode, target: int, rng: np.random.Generator) -> Start:
            if recorded:  # once: in another scene it may touch something
                return self._skill.recorded_start(episode, recorded.pop())
            return self._skill.draw_start(episode, target, rng)

        begin(world, lane, self.scene(number, target), draw, episode, target, rng)
        if self._options.training:
            world.simulator(lane).set_rolling(LEVERS[int(rng.integers(len(LEVERS)))])
        return episode

    def scene(self, number: int, target: int) -> Scene:
        """Return the scene of an episode with one target and, if wanted, the clutter."""
        return episode_scene(self.episodes[number], replace(self._options.scene, targets=(target,)))


@lru_cache(maxsize=8)
def episode_sampler(options: SkillEnvOptions) -> EpisodeSampler:
    """Return the cached sampler of these options, so that a learner that rebuilds its worlds loads them once."""
    return EpisodeSampler(options)


StepResult = tuple[FloatArray, FloatArray, BoolArray, BoolArray, dict[str, Any]]


class HomeSkillVectorEnv(gymnasium.vector.VectorEnv[FloatArray, FloatArray, Any]):
    """n lanes of one skill. A lane's trajectory depends on its own seed and actions only, bit for bit.

    terminated: the skill succeeded or failed. truncated: `max_episode_steps` was reached, or the simulation diverged. A
    diverged lane gets reward 0 for that step, returns the observation of its episode's start and is counted in
    `diverged`.

    info has arrays `success`, `failure` (its label, "none" for none), `diverged` and `elapsed`, and an array for each
    reward term under `reward_terms`.

    No autoreset: the caller resets lanes that have ended, with `options["reset_mask"]`.
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        max_episode_steps: int | None = None,
        threads: int | None = None,
        registered_skill: str | None = None,
        **options: Any,
    ) -> None:
        """Load the episodes; scenes are built when they are needed.

        Args:
            num_envs: Number of lanes.
            max_episode_steps: Steps after which a lane is truncated, None for no limit.
            threads: Simulation threads; as many as the process may use cores when None. Results do not depend on it.
            registered_skill: The skill of the Gymnasium id that makes this environment, which `skill` must then be.
            options: Fields of `SkillEnvOptions`.

        Raises:
            PerdureError: If an option is unknown, of a wrong type or does not fit the others.
        """
        given = {"num_envs": num_envs, "max_episode_steps": max_episode_steps, "threads": threads}
        check_kinds({"num_envs": COUNT, "max_episode_steps": Maybe(Whole(1, 10**9)), "threads": Maybe(COUNT)}, given)
        self.metadata = {"autoreset_mode": AutoresetMode.DISABLED, "render_modes": []}
        self.options = checked_options(options)
        skill = self.options.skill
        if registered_skill not in (None, skill):
            raise PerdureError(
                f"{env_id(registered_skill)} has the skill {registered_skill}, not {skill}: use {env_id(skill)}"
            )
        self.skill: Skill = self.options.make_skill()
        if max_episode_steps is not None and max_episode_steps < self.options.delta:  # the object cannot stay so long
            raise PerdureError(
                f"no episode of {max_episode_steps} steps can succeed with delta={self.options.delta}; "
                f"also give max_episode_steps={self.skill.limit}"
            )
        self.sampler = episode_sampler(self.options)
        self.num_envs = num_envs
        self.max_episode_steps = max_episode_steps
        self.world = VectorSimulator(num_envs, threads)
        self.diverged = np.zeros(num_envs, dtype=np.int64)
        """Number of divergences of each lane. Shape (num_envs,)."""
        self._set_spaces()
        self._rng: list[np.random.Generator | None] = [None] * num_envs
        self._over = np.ones(num_envs, dtype=bool)
        self._state: PrivilegedState | None = None
        self._progress: SkillProgress | None = None

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[FloatArray, dict[str, Any]]:
        """Begin new episodes.

        Args:
            seed: Lane k gets seed + k, or the k-th of a sequence; None keeps the lane's generator.
            options: `reset_mask`: which lanes to reset, shape (num_envs,); all by default.

        Returns:
            Observations of all lanes, those that were not reset unchanged, and an empty info.

        Raises:
            PerdureError: If the number of seeds is not that of the lanes, or the first reset leaves lanes out.
        """
        mask = self._mask(options)
        for number, one in enumerate(self._seeds(seed)):
            if mask[number] and (one is not None or self._rng[number] is None):
                self._rng[number] = np.random.Generator(np.random.PCG64(one))
        state, progress = self._begin(np.flatnonzero(mask))
        return self.skill.observe(state, progress), {}

    def step(self, actions: FloatArray) -> StepResult:
        """Run one control step of all lanes.

        Args:
            actions: Shape (num_envs, m); values outside [-1, 1] are clipped.

        Raises:
            PerdureError: If a lane has ended and was not reset, or actions have a wrong shape or are not finite.
        """
        if self._state is None or self._progress is None or self._over.any():
            over = np.flatnonzero(self._over).tolist()
            raise PerdureError(f"lanes {over} have ended or never begun: reset them first")
        skill = self.skill
        before = self._state
        was = self._progress
        full = skill.expand_action(self._checked(actions), before)
        self.world.step(skill.mask(full, before), None, skill.base_speed, skill.arm_step)
        after = self.world.sense(None, skill.scan_reach, skill.needs_neighbors)
        now = skill.advance(was, after)
        self._state = after
        self._progress = now

        # A lane whose simulation diverged neither succeeds nor fails, and earns nothing.
        sound = ~after.diverged
        rewards, terms = skill.reward(before, after, was, now)
        success = skill.success(after, now) & sound
        failure = np.where(sound, skill.failure(after, now), 0)
        terminated = success | (failure > 0)
        truncated = after.diverged.copy()
        if self.max_episode_steps is not None:
            truncated |= now.elapsed >= self.max_episode_steps
        self.diverged += after.diverged
        self._over = terminated | truncated
        info = {
            "success": success,
            "failure": np.array(skill.failure_labels)[failure],
            "diverged": after.diverged.copy(),
            "elapsed": now.elapsed.copy(),
            "reward_terms": masked({name: np.where(sound, value, 0.0) for name, value in terms.items()}),
        }
        return skill.observe(after, now), np.where(sound, rewards, 0.0), terminated, truncated, masked(info)

    @property
    def state(self) -> PrivilegedState:
        """Return the privileged state of all lanes; PerdureError before the first reset."""
        if self._state is None:
            raise PerdureError("state does not exist before the first reset")
        return self._state

    @property
    def progress(self) -> SkillProgress:
        """Return the skill's progress in all lanes; PerdureError before the first reset."""
        if self._progress is None:
            raise PerdureError("progress does not exist before the first reset")
        return self._progress

    def close_extras(self, **kwargs: Any) -> None:
        """Stop the threads."""
        self.world.close()

    def _begin(self, lanes: IntArray) -> tuple[PrivilegedState, SkillProgress]:
        """Begin episodes in some lanes; return state and progress of all lanes."""
        for lane in map(int, lanes):
            rng = self._rng[lane]
            assert rng is not None
            self.sampler.begin(self.world, lane, rng)
        fresh = self.world.sense(lanes, self.skill.scan_reach, self.skill.needs_neighbors)
        begun = self.skill.begin(fresh)
        if self._state is None or self._progress is None:
            self._state = fresh
            self._progress = begun
        else:
            self._state = self._state.put(lanes, fresh)
            self._progress = self._progress.put(lanes, begun)
        self._over[lanes] = False
        return self._state, self._progress

    def _set_spaces(self) -> None:
        low = np.array([each.low for each in self.skill.elements])
        high = np.array([each.high for each in self.skill.elements])
        self.single_observation_space = gymnasium.spaces.Box(low, high, dtype=np.float64)
        self.single_action_space = gymnasium.spaces.Box(-1.0, 1.0, (self.skill.action_size,), dtype=np.float64)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def _checked(self, actions: FloatArray) -> FloatArray:
        given = np.asarray(actions, dtype=np.float64)
        if given.shape != self.action_space.shape:
            raise PerdureError(f"actions must have shape {self.action_space.shape}, not {given.shape}")
        return given

    def _mask(self, options: Mapping[str, Any] | None) -> BoolArray:
        mask = np.ones(self.num_envs, dtype=bool)
        if options is not None and options.get("reset_mask") is not None:
            mask = np.asarray(options["reset_mask"])
            if mask.shape != (self.num_envs,) or mask.dtype != bool:
                raise PerdureError(f"reset_mask must be {self.num_envs} booleans, not {options['reset_mask']!r}")
        if self._state is None and not mask.all():
            raise PerdureError("reset_mask must select all lanes in the first reset")
        return mask

    def _seeds(self, seed: int | Sequence[int | None] | None) -> Sequence[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, int | np.integer):
            return [int(seed) + lane for lane in range(self.num_envs)]
        seeds = list(seed)
        if len(seeds) != self.num_envs:
            raise PerdureError(f"seed must have one entry for each of {self.num_envs} lanes, not {len(seeds)}")
        return seeds


def masked(info: dict[str, Any]) -> dict[str, Any]:
    """Return an info with Gymnasium's `_name` beside each entry, which says that all lanes have it."""
    size = len(next(value for value in info.values() if isinstance(value, np.ndarray)))
    return {**info, **{f"_{name}": np.ones(size, dtype=bool) for name in info}}


class HomeSkillEnv(gymnasium.Env[FloatArray, FloatArray]):
    """One lane of a `HomeSkillVectorEnv`: the same seed and actions give the same bits."""

    def __init__(self, *, threads: int = 1, **options: Any) -> None:
        """Create the environment.

        Args:
            threads: As for the vector; one lane never uses more than one.
            options: Fields of `SkillEnvOptions`, and other settings of the vector.

        Raises:
            PerdureError: If an option does not exist or fit.
        """
        self.lanes = HomeSkillVectorEnv(1, threads=threads, **options)
        self.observation_space = self.lanes.single_observation_space
        self.action_space = self.lanes.single_action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[FloatArray, dict[str, Any]]:
        """See `gymnasium.Env.reset`."""
        super().reset(seed=seed)
        observations, _ = self.lanes.reset(seed=seed)
        return observations[0], {}

    def step(self, action: FloatArray) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:
        """See `gymnasium.Env.step`."""
        batch = np.asarray(action, dtype=np.float64)[None]
        observations, rewards, terminated, truncated, info = self.lanes.step(batch)
        return observations[0], float(rewards[0]), bool(terminated[0]), bool(truncated[0]), _first(info)

    def close(self) -> None:
        """Release the lane's resources."""
        self.lanes.close()


def _first(info: dict[str, Any]) -> dict[str, Any]:
    """Return the entries of the only lane."""
    first: dict[str, Any] = {}
    for name, value in info.items():
        if name.startswith("_"):
            continue
        if isinstance(value, dict):
            first[name] = _first(value)
        else:
            first[name] = value[0].item()
    return first


SUITE = VectorSuite("Home", "perdure.home.skills.gym", PREFIX)
"""The suite of these environments, which `pyproject.toml` names as an entry point."""


def register() -> None:
    """Register an environment for each learned skill that has none; call it again after adding a skill."""
    for skill in learned_skills():
        if env_id(skill) in gymnasium.registry:
            continue
        task = next(name for name, task in TASKS.items() if targets_of(skill, task))
        gymnasium.register(
            env_id(skill),
            entry_point="perdure.home.skills.gym:HomeSkillEnv",
            vector_entry_point="perdure.home.skills.environment:HomeSkillVectorEnv",
            max_episode_steps=get_skill(skill).limit,
            kwargs={"skill": skill, "task": task, "registered_skill": skill},
        )
