"""Many lanes of one skill in one `VectorSimulator`, as a Gymnasium vector environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from perdure.home.errors import HomeError
from perdure.home.sim.arrays import BoolArray, FloatArray, IntArray
from perdure.home.sim.world import PrivilegedState, VectorSimulator
from perdure.home.skills.gym.checks import check_kinds, checked_mode
from perdure.home.skills.gym.episode_sampler import episode_sampler
from perdure.home.skills.gym.options import COUNT, checked_options
from perdure.home.skills.gym.register import check_id
from perdure.home.skills.progress import SkillProgress, put_rows
from perdure.home.skills.skill import Skill
from perdure.schema import Maybe, Whole

StepResult = tuple[FloatArray, FloatArray, BoolArray, BoolArray, dict[str, Any]]


class HomeSkillVectorEnv(gymnasium.vector.VectorEnv[FloatArray, FloatArray, Any]):
    """n lanes of one skill. A lane's trajectory depends on its own seed and actions only, bit for bit.

    terminated: the skill succeeded or failed. truncated: `max_episode_steps` was reached, or the simulation diverged. A
    diverged lane gets reward 0 for that step, returns the observation of its episode's start and is counted in
    `diverged`.

    info has arrays `success`, `failure` (its label, "none" for none), `diverged` and `elapsed`, and an array for each
    reward term under `reward_terms`.

    Autoreset modes: DISABLED (the caller resets, with `options["reset_mask"]`), NEXT_STEP (the next step of an ended
    lane begins its next episode, with reward 0), SAME_STEP (the last observation and info are in `final_obs` and
    `final_info`).
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        max_episode_steps: int | None = None,
        threads: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.DISABLED,
        registered_skill: str | None = None,
        **options: Any,
    ) -> None:
        """Load the episodes; scenes are built when they are needed.

        Args:
            num_envs: Number of lanes.
            max_episode_steps: Steps after which a lane is truncated, None for no limit.
            threads: Simulation threads; as many as the process may use cores when None. Results do not depend on it.
            autoreset_mode: See the class.
            registered_skill: The skill of the Gymnasium id that makes this environment, which `skill` must then be.
            options: Fields of `SkillEnvOptions`.

        Raises:
            HomeError: If an option is unknown, of a wrong type or does not fit the others.
        """
        given = {"num_envs": num_envs, "max_episode_steps": max_episode_steps, "threads": threads}
        check_kinds({"num_envs": COUNT, "max_episode_steps": Maybe(Whole(1, 10**9)), "threads": Maybe(COUNT)}, given)
        self.metadata = {"autoreset_mode": checked_mode(autoreset_mode), "render_modes": []}
        self.options = checked_options(options)
        check_id(self.options.skill, registered_skill)
        self.options.check_step_limit(max_episode_steps)
        self.skill: Skill = self.options.make_skill()
        self.sampler = episode_sampler(self.options)
        self.num_envs, self.max_episode_steps = num_envs, max_episode_steps
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
            HomeError: If the number of seeds is not that of the lanes, or the first reset leaves lanes out.
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
            HomeError: If a lane has ended and was not reset, or actions have a wrong shape or are not finite.
        """
        mode, renewed = self.metadata["autoreset_mode"], self._over.copy()
        if self._state is None or self._progress is None or (mode is AutoresetMode.DISABLED and renewed.any()):
            raise HomeError(f"lanes {np.flatnonzero(renewed).tolist()} have ended or never begun: reset them first")
        full = self.skill.expand_action(self._checked(actions))
        stepped = np.flatnonzero(~renewed)
        if renewed.any():
            self._begin(np.flatnonzero(renewed))
        outcome = self._advance(self._state, self._progress, full, stepped)
        return self._same_step(outcome) if mode is AutoresetMode.SAME_STEP and self._over.any() else outcome

    @property
    def state(self) -> PrivilegedState:
        """Return the privileged state of all lanes; HomeError before the first reset."""
        if self._state is None:
            raise HomeError("state does not exist before the first reset")
        return self._state

    @property
    def progress(self) -> SkillProgress:
        """Return the skill's progress in all lanes; HomeError before the first reset."""
        if self._progress is None:
            raise HomeError("progress does not exist before the first reset")
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
            self._state, self._progress = fresh, begun
        else:
            self._state, self._progress = put_rows(self._state, lanes, fresh), self._progress.put(lanes, begun)
        self._over[lanes] = False
        return self._state, self._progress

    def _advance(self, before: PrivilegedState, was: SkillProgress, actions: FloatArray, lanes: IntArray) -> StepResult:
        """Step some lanes; the others have just begun, so their outcome has no reward."""
        skill, stepped = self.skill, np.zeros(self.num_envs, dtype=bool)
        stepped[lanes] = True
        if len(lanes):
            legal = skill.mask(actions, before)
            self.world.step(legal[lanes], lanes, skill.base_speed, skill.arm_step)
        after = self.world.sense(None, skill.scan_reach, skill.needs_neighbors)
        now = skill.advance(was, after) if stepped.all() else was.put(lanes, skill.advance(was[lanes], after[lanes]))
        self._state, self._progress = after, now
        return self._outcome(before, after, was, now, stepped)

    def _outcome(
        self,
        before: PrivilegedState,
        after: PrivilegedState,
        was: SkillProgress,
        now: SkillProgress,
        stepped: BoolArray,
    ) -> StepResult:
        skill, diverged = self.skill, stepped & after.diverged
        sound = stepped & ~diverged
        rewards, terms = skill.reward(before, after, was, now)
        success = skill.success(after, now) & sound
        failure = np.where(sound, skill.failure(after, now), 0)
        terminated, truncated = success | (failure > 0), diverged.copy()
        if self.max_episode_steps is not None:
            truncated |= stepped & (now.elapsed >= self.max_episode_steps)
        self.diverged += diverged
        self._over = terminated | truncated
        info = {
            "success": success,
            "failure": np.array(skill.failure_labels)[failure],
            "diverged": diverged,
            "elapsed": now.elapsed.copy(),
            "reward_terms": masked({name: np.where(sound, value, 0.0) for name, value in terms.items()}),
        }
        return skill.observe(after, now), np.where(sound, rewards, 0.0), terminated, truncated, masked(info)

    def _same_step(self, outcome: StepResult) -> StepResult:
        """Begin the next episode of lanes that have just ended."""
        last, rewards, terminated, truncated, info = outcome
        over = self._over.copy()
        state, progress = self._begin(np.flatnonzero(over))
        final = {"final_obs": last, "_final_obs": over, "final_info": info, "_final_info": over}
        return self.skill.observe(state, progress), rewards, terminated, truncated, {**info, **final}

    def _set_spaces(self) -> None:
        low, high = (np.array([getattr(each, end) for each in self.skill.elements]) for end in ("low", "high"))
        self.single_observation_space = gymnasium.spaces.Box(low, high, dtype=np.float64)
        self.single_action_space = gymnasium.spaces.Box(-1.0, 1.0, (len(self.skill.active_columns),), dtype=np.float64)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def _checked(self, actions: FloatArray) -> FloatArray:
        given = np.asarray(actions, dtype=np.float64)
        if given.shape != self.action_space.shape:
            raise HomeError(f"actions must have shape {self.action_space.shape}, not {given.shape}")
        return given

    def _mask(self, options: Mapping[str, Any] | None) -> BoolArray:
        mask = np.ones(self.num_envs, dtype=bool)
        if options is not None and options.get("reset_mask") is not None:
            mask = np.asarray(options["reset_mask"])
            if mask.shape != (self.num_envs,) or mask.dtype != bool:
                raise HomeError(f"reset_mask must be {self.num_envs} booleans, not {options['reset_mask']!r}")
        if self._state is None and not mask.all():
            raise HomeError("reset_mask must select all lanes in the first reset")
        return mask

    def _seeds(self, seed: int | Sequence[int | None] | None) -> Sequence[int | None]:
        if seed is None:
            return [None] * self.num_envs
        seeds = [int(seed) + k for k in range(self.num_envs)] if isinstance(seed, int | np.integer) else list(seed)
        if len(seeds) != self.num_envs:
            raise HomeError(f"seed must have one entry for each of {self.num_envs} lanes, not {len(seeds)}")
        return seeds


def masked(info: dict[str, Any]) -> dict[str, Any]:
    """Return an info with Gymnasium's `_name` beside each entry, which says that all lanes have it."""
    size = len(next(value for value in info.values() if isinstance(value, np.ndarray)))
    return {**info, **{f"_{name}": np.ones(size, dtype=bool) for name in info}}
