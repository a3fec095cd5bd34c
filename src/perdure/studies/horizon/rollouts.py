"""Record observations and rewards of short rollouts, for the mechanism tables and the critic's rule."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perdure.envs import make_world
from perdure.horizon import Clock
from perdure.policy import ClosedLoop, LanePolicy, Policy
from perdure.policy.one_thread import one_thread

FIRST_SEED = 3_000_000
"""World seed of lane 0. Evaluation seeds, which begin at 1,000,000, never come here."""
WITHOUT_END = 1000.0
"""Steps that stand for a training horizon without an end."""

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Rollout:
    """n lanes for at most m steps. After a lane's end: rewards 0, observations nan."""

    observations: FloatArray
    """What was acted on, shape (m, n, observation size)."""
    rewards: FloatArray
    """Shape (m, n)."""
    lengths: NDArray[np.int64]
    """Steps each lane made, shape (n,)."""
    fell: NDArray[np.bool_]
    """Whether the task ended the lane, shape (n,)."""

    @property
    def made(self) -> NDArray[np.bool_]:
        """Which steps were made, shape (m, n)."""
        return np.arange(len(self.rewards))[:, None] < self.lengths[None, :]

    @property
    def lane_steps(self) -> int:
        """Steps of all lanes together."""
        return int(self.lengths.sum())


def roll_out(policy: Policy, clocks: Sequence[Clock | None], steps: int, first_seed: int = FIRST_SEED) -> Rollout:
    """Run a policy in one lane for each clock, each from a different start state, without a horizon."""
    lanes = len(clocks)
    world = make_world(policy.task.name, [first_seed + lane for lane in range(lanes)])
    observations = np.full((steps, lanes, policy.task.observation_size), np.nan)
    rewards = np.zeros((steps, lanes))
    lengths, fell = np.full(lanes, steps), np.zeros(lanes, bool)
    try:
        loop = ClosedLoop(world, [LanePolicy(policy, clock) for clock in clocks])
        with one_thread():
            for step in range(steps):
                if not len(loop.running):
                    break
                moved = loop.advance()
                observations[step, moved.lanes] = moved.before
                rewards[step, moved.lanes] = np.nan_to_num(moved.step.rewards)
                ended = moved.lanes[moved.step.ended]
                lengths[ended] = step + 1
                fell[moved.lanes[moved.step.terminated]] = True
    finally:
        world.close()
    return Rollout(observations, rewards, lengths, fell)


def draw_horizons(policy: Policy, lanes: int) -> NDArray[np.int64]:
    """Return training horizons, evenly over their distribution, shape (lanes,)."""
    drawn = np.asarray(policy.protocol.horizon.from_uniform((np.arange(lanes) + 0.5) / lanes), np.float64)
    return np.where(np.isfinite(drawn), drawn, WITHOUT_END).astype(np.int64)


def thinned(rollout: Rollout, most: int) -> FloatArray:
    """Return visited states, at most so many, evenly over steps and lanes; shape (states, observation size)."""
    states: FloatArray = rollout.observations[rollout.made]
    return states[:: -(-len(states) // most)]
