"""Detect simulations that diverged, from what a closed loop shows of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from perdure.envs import IntArray
from perdure.policy.closed_loop import LoopStep

REWARD_FACTOR = 10.0
"""A reward is impossible if it exceeds this many times the largest before it ..."""
REWARD_MARGIN = 50.0
"""... plus this much, so that small first rewards do not make later ones look impossible."""
FAR = 6.0
"""Standard deviations from the first observation, in some component, that count as far away."""
NEAR = 1.0
"""Standard deviations from the first observation, in every component, that count as next to it."""
SMALLEST_JUMP = 0.999 * (FAR - NEAR)
"""A jump back moves some component by at least FAR - NEAR deviations (less rounding): a cheap first test."""


class DivergenceDetector:
    """Detects divergence from the rewards and first observations of each episode.

    MuJoCo resets a diverging simulation to its start and only logs a warning. The episode seems to continue, and the
    jump back gives one very large, often positive, reward. Any one of three signs ends the episode as "diverged"; the
    reward of that step is not counted.

    1. An observation or reward that is not finite, or the engine's own report.
    2. A reward far outside the episode's earlier ones. A locomotion reward contains the speed, and a reset from x
       meters away is a speed of x / dt.
    3. A jump back: within one step the observation moves from far away to near the episode's first one, measured in
       standard deviations of the policy's normalizer.

    Signs 2 and 3 count only where the engine hides a divergence (`TaskSpec.hides_divergence`), and not in the last step
    of an episode: elsewhere a reward of 100 is a goal, or the price of a fall. A reset within the first meters of an
    episode, from an ordinary pose, shows none of the three signs. For Gymnasium environments in this process, also
    inside a SyncVectorEnv, perdure reads MuJoCo's warnings, so that every divergence is detected. In other vector
    environments only sign 1 applies.

    Args:
        first_observations: Shape (episodes, d).
        scale: Standard deviation of each component as the episode's policy knows it, shape (episodes, d).
        hidden: Whether the engine hides divergences.
    """

    def __init__(self, first_observations: NDArray[np.float64], scale: NDArray[np.float64], hidden: bool) -> None:
        self._hidden = hidden
        self._first = first_observations.copy()
        # A component that never varied in training says nothing about distance.
        self._scale = np.where(scale > 1e-6, scale, np.inf)
        self._per_deviation = 1.0 / self._scale
        self._largest = np.zeros(len(first_observations))
        self.signs = [""] * len(first_observations)
        """What gave each episode away that has blown up, in words."""

    def diverged(self, loop_step: LoopStep) -> NDArray[np.bool_]:
        """Return which of the episodes in this step have diverged, shape (n,)."""
        episodes = loop_step.episodes
        rewards = loop_step.step.rewards
        after = loop_step.step.observations
        with np.errstate(invalid="ignore", over="ignore"):
            size = np.abs(rewards)
            largest = self._largest[episodes]
            # The sum is finite only if every term is: one pass instead of two. Large finite terms may overflow, too.
            bad: NDArray[np.bool_] = ~np.isfinite(rewards + after.sum(axis=1))
            if bad.any():
                bad[bad] = ~(np.isfinite(rewards[bad]) & np.isfinite(after[bad]).all(axis=1))
            bad |= loop_step.step.diverged
            if self._hidden:
                # The first reward has nothing to be compared with.
                goes_on = (loop_step.step.elapsed > 1) & ~loop_step.step.ended
                bad |= (size > REWARD_FACTOR * largest + REWARD_MARGIN) & goes_on
            for row in np.flatnonzero(bad):
                self.signs[episodes[row]] = _first_sign(loop_step, int(row))
            if self._hidden:
                back = self._jumped_back(loop_step)
                for row in back[~bad[back]]:
                    self.signs[episodes[row]] = "put back to its start within a step"
                bad[back] = True
        self._largest[episodes] = np.where(bad, largest, np.maximum(largest, size))
        return bad

    def _jumped_back(self, loop_step: LoopStep) -> NDArray[np.int64]:
        """Return the rows of the episodes that moved from far away to their start in this step and did not end."""
        episodes = loop_step.episodes
        before = loop_step.before
        after = loop_step.step.observations
        change = after - before
        change *= self._per_deviation[episodes]
        jumps = np.abs(change, out=change) > SMALLEST_JUMP
        if not np.count_nonzero(jumps):
            return np.zeros(0, np.int64)
        rows: IntArray = np.flatnonzero(jumps.any(axis=1) & ~loop_step.step.ended)
        first = self._first[episodes[rows]]
        scale = self._scale[episodes[rows]]
        was_far = (np.abs(before[rows] - first) / scale).max(axis=1) > FAR
        is_near = (np.abs(after[rows] - first) / scale).max(axis=1) < NEAR
        back: IntArray = rows[was_far & is_near]
        return back


def _first_sign(loop_step: LoopStep, row: int) -> str:
    """Return the first sign of divergence other than the jump back to the start."""
    if loop_step.step.diverged[row]:
        return "reported by the physics engine"
    if not np.isfinite(loop_step.step.observations[row]).all():
        return "an observation that is not finite"
    reward = loop_step.step.rewards[row]
    if not np.isfinite(reward):
        return "a reward that is not finite"
    return f"an impossible reward of {reward:.3g}"
