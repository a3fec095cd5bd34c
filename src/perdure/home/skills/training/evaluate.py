"""Success rate of a policy in its skill, from fresh start states."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from perdure.home.sim.arrays import BoolArray, IntArray
from perdure.home.skills.gym import HomeSkillVectorEnv
from perdure.policy import Policy


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
        """Return the share of successes."""
        return float(self.success.mean())

    def summary(self) -> str:
        """Return the score as one line."""
        n, endings = len(self.success), ", ".join(f"{name} {count}" for name, count in self.failures.most_common())
        steps = f", {self.steps[self.success].mean():.0f} steps" if self.success.any() else ""
        return f"{self.rate:.3f} of {n} episodes{steps}; {endings or 'no failure'}"


def evaluate_skill(
    policy: Policy, skill: str, count: int = 200, seed: int = 1000, lanes: int = 20, **options: Any
) -> SkillScore:
    """Run a policy with its mean actions and count successes.

    Each lane runs the same number of episodes, so that short ones do not count more often than long ones.

    Args:
        policy: Trained on the skill's environment.
        skill: Name of the skill.
        count: Number of episodes, rounded up to a multiple of `lanes`.
        seed: Lane k draws its start states from seed + k.
        lanes: Number of lanes.
        options: Options of the environment; by default the published val episodes with their clutter.
    """
    options = {"split": "val", "clutter": True, **options}
    env = HomeSkillVectorEnv(lanes, skill=skill, **options)
    limit = env.skill.limit
    rounds = -(-count // lanes)
    success, steps, failures = [], [], Counter[str]()
    left = np.full(lanes, rounds)
    observations, _ = env.reset(seed=seed)
    elapsed = np.zeros(lanes, dtype=np.int64)
    try:
        while left.any():
            actions = np.asarray(policy.act(observations, elapsed), dtype=np.float64)
            observations, _, terminated, truncated, info = env.step(actions)
            elapsed = info["elapsed"].copy()
            over = terminated | truncated | (elapsed >= limit)
            for lane in np.flatnonzero(over & (left > 0)):
                left[lane] -= 1
                success.append(bool(info["success"][lane]))
                steps.append(int(elapsed[lane]))
                if not success[-1]:
                    label = "diverged" if info["diverged"][lane] else str(info["failure"][lane])
                    failures[_time_out(env, int(lane)) if label == "none" else label] += 1
            if over.any():
                observations, _ = env.reset(options={"reset_mask": over})
                elapsed[over] = 0
    finally:
        env.close()
    return SkillScore(np.array(success), np.array(steps), failures)


def _time_out(env: HomeSkillVectorEnv, lane: int) -> str:
    row = np.array([lane])
    unmet = env.skill.unmet(env.state[row], env.progress[row])
    return ", ".join(["time-out", *[condition for condition, true in unmet.items() if true[0]][:1]])
