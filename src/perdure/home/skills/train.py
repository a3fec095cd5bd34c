"""Train skills, and measure how often their policies succeed from fresh start states."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from perdure.home.sim.arrays import BoolArray, IntArray
from perdure.home.sim.scene import EARLIER, SceneOptions
from perdure.home.skills.environment import HomeSkillVectorEnv, checked_options
from perdure.home.skills.place import variant_name
from perdure.home.skills.registry import env_id, get_skill
from perdure.home.skills.starts import plan_starts_file
from perdure.horizon import Countdown
from perdure.learn import PPOConfig, method_config
from perdure.learn.run import TrainRun, train
from perdure.policy import Policy
from perdure.runs import file_digest

SETTINGS: dict[str, Any] = {
    "hidden_sizes": (256, 256),
    "n_envs": 32,
    "n_steps": 128,
    "batch_size": 512,
    "n_epochs": 5,
    "learning_rate": 3e-4,
    "learning_rate_decay": "linear",
    "log_std_init": -1.0,
    "segment_steps": 100_000,
}
"""Settings of PPO for all skills. A recipe lowers `log_std_end` where the mean action alone would never open or close
the hand, because training relied on noise to do it."""


def train_skill(
    skill: str,
    task: str,
    seeds: tuple[int, ...],
    out: str | Path,
    total_steps: int | None = None,
    *,
    method: str = "ppo",
    cores: int | None = None,
    **options: object,
) -> list[Path]:
    """Train a skill on this machine with its recipe; the same call resumes an interrupted training.

    Args:
        skill: Name of the skill.
        task: The task whose objects and places are used.
        seeds: Training seeds.
        out: The folder of the runs.
        total_steps: Environment steps in place of the recipe's.
        method: A key of `perdure.learn.METHODS`; the runs of another method than ppo lie in SKILL-METHOD.
        cores: Number of cores; all by default.
        options: Options of the environment, such as `delta`.

    Returns:
        The policy files, one for each seed.
    """
    return train(skill_run(skill, task, seeds, total_steps, method, **options), out, cores=cores)


def skill_run(
    skill: str,
    task: str,
    seeds: tuple[int, ...],
    total_steps: int | None = None,
    method: str = "ppo",
    **options: object,
) -> TrainRun:
    """Return what `train_skill` trains, with the digest of the start states that are recorded so far."""
    config = skill_config(skill, task, total_steps, method=method, **options)
    command = train_command(skill, task, total_steps, options, method)
    name = skill
    if method != "ppo":
        name = f"{skill}-{method}"
    # The policy's file names the physics: files that do not are of the earlier one.
    physics = {name: getattr(SceneOptions, name) for name in EARLIER}
    env_options = {**get_skill(skill).recipe_on(task).env_options, **physics, **options}
    inputs = ""
    starts = plan_starts_file(task)
    if env_options.get("training") and starts.exists():
        inputs = file_digest(starts)
    return TrainRun(skill_task(skill, task, **env_options), name, config, seeds, command, inputs=inputs)


def skill_config(
    skill: str, task: str, total_steps: int | None = None, *, method: str = "ppo", **options: object
) -> PPOConfig:
    """Return PPO's settings for a skill on a task, with options of the environment.

    The method's horizons scale with the skill's step limit. `ppo` bootstraps the last observation, because the plan
    continues after a time-out. For a policy that observes the time-to-go the horizon is the end.
    """
    made = checked_options({"skill": skill, "task": task, **options}).make_skill()
    recipe = made.recipe_on(task)
    config = method_config(method, task, len(made.elements), limit=made.limit)
    steps = recipe.total_steps if total_steps is None else total_steps
    return replace(config, **{**SETTINGS, **recipe.settings}, total_steps=steps)


def skill_task(skill: str, task: str, **options: object) -> str:
    """Return the name of a skill's environment with its options, for `perdure.envs.make_world`."""
    parts = [env_id(skill), f"task={task}", *(f"{name}={value}" for name, value in options.items())]
    return ",".join(part.replace(" ", "") for part in parts)


def train_command(
    skill: str, task: str, total_steps: int | None, options: Mapping[str, object], method: str = "ppo"
) -> str:
    """Return the command that trains `{seed}` again; a Python call for options without a flag."""
    how = {}
    if method != "ppo":
        how["method"] = method
    variant = variant_name(options)
    if variant or not options:
        flags = {"task": task, "variant": variant, **how, "seeds": "{seed}", "steps": total_steps}
        words = [f"--{name} {value}" for name, value in flags.items() if value is not None]
        return f"perdure home train {skill} " + " ".join(words)
    given = "".join(f", {name}={value!r}" for name, value in {"total_steps": total_steps, **how, **options}.items())
    return f"perdure.home.skills.train.train_skill({skill!r}, {task!r}, ({{seed}},), OUT{given})"


@dataclass(frozen=True)
class SkillScore:
    """Outcomes of episodes of one skill."""

    success: BoolArray
    """Whether each episode succeeded. Shape (episodes,)."""
    steps: IntArray
    """Control steps of each episode. Shape (episodes,)."""
    failures: Counter[str]
    """Counts of the other endings: a failure's name, "diverged", or "time-out" with the first unmet condition."""

    @property
    def rate(self) -> float:
        """The share of successes."""
        return float(self.success.mean())

    @property
    def summary(self) -> str:
        """The score as one line."""
        words = f"{self.rate:.3f} of {len(self.success)} episodes"
        if self.success.any():
            words += f", {self.steps[self.success].mean():.0f} steps"
        endings = ", ".join(f"{name} {count}" for name, count in self.failures.most_common())
        return f"{words}; {endings or 'no failure'}"


def evaluate_skill(
    policy: Policy, skill: str, count: int = 200, seed: int = 1000, lanes: int = 20, **options: Any
) -> SkillScore:
    """Run a policy with its mean actions and count successes; a time-to-go counts down from the skill's limit.

    Each lane runs the same number of episodes, so that short ones do not count more often than long ones.

    Args:
        policy: Trained on the skill's environment.
        skill: Name of the skill.
        count: Number of episodes, rounded up to a multiple of `lanes`.
        seed: Lane k draws its start states from seed + k.
        lanes: Largest number of lanes.
        options: Options of the environment; by default the published val episodes with their clutter.
    """
    lanes = min(lanes, count)
    env = HomeSkillVectorEnv(lanes, skill=skill, **{"split": "val", "clutter": True, **options})
    limit = env.skill.limit
    clock = Countdown(limit) if policy.has_clock else None
    success = []
    steps = []
    failures = Counter[str]()
    left = np.full(lanes, -(-count // lanes))
    observations, _ = env.reset(seed=seed)
    elapsed = np.zeros(lanes, dtype=np.int64)
    try:
        while left.any():
            actions = np.asarray(policy.act(observations, elapsed, clock), dtype=np.float64)
            observations, _, terminated, truncated, info = env.step(actions)
            elapsed = info["elapsed"].copy()

            # Count the episodes that end in this step, but not those beyond a lane's share.
            over = terminated | truncated | (elapsed >= limit)
            for lane in np.flatnonzero(over & (left > 0)):
                left[lane] -= 1
                success.append(bool(info["success"][lane]))
                steps.append(int(elapsed[lane]))
                if not success[-1]:
                    failures[_ending(env, int(lane), info)] += 1
            if over.any():
                observations, _ = env.reset(options={"reset_mask": over})
                elapsed[over] = 0
    finally:
        env.close()
    return SkillScore(np.array(success), np.array(steps), failures)


def _ending(env: HomeSkillVectorEnv, lane: int, info: Mapping[str, Any]) -> str:
    """Return how a lane's episode ended without success, see `SkillScore.failures`."""
    if info["diverged"][lane]:
        return "diverged"
    if info["failure"][lane] != "none":
        return str(info["failure"][lane])
    row = np.array([lane])
    unmet = env.skill.unmet(env.state[row], env.progress[row])
    return ", ".join(["time-out", *[condition for condition, true in unmet.items() if true[0]][:1]])
