"""Episodes of a policy within its training horizon: the baseline of its score against its own training.

At its end, training records them in the policy file. For other policies, the first evaluation records them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perdure.envs import TaskSpec, World, make_world
from perdure.errors import PerdureError, warn
from perdure.horizon import Clock, Countdown, TimeFeature
from perdure.policy.closed_loop import ClosedLoop, EpisodePolicy, LoopStep, PolicyLike
from perdure.policy.divergence import DivergenceDetector
from perdure.policy.network import one_thread

BIN_STEPS = 10
"""Steps whose rewards are stored as one sum."""
EPISODES = 20
"""Episodes that training measures."""
FIRST_SEED = 500_000
"""Episode k starts from world seed FIRST_SEED + k: start states that neither training nor an evaluation uses."""
LONGEST_HORIZON = 100_000_000
"""Steps of a training episode."""


@dataclass(frozen=True, eq=False)
class Reference:
    """Episodes of a deterministic policy under the conditions it was trained in: horizon T and a countdown to it.

    Raises:
        PerdureError: If the arrays do not fit together.
    """

    horizon: int
    """T: steps an episode may last."""
    rewards: NDArray[np.float64]
    """Reward sums of BIN_STEPS steps each, shape (episodes, ceil(horizon / BIN_STEPS)); 0 after an episode's end."""
    lengths: NDArray[np.int64]
    """Steps of each episode, the last one included, shape (episodes,)."""
    terminated: NDArray[np.bool_]
    """Whether the task ended the episode other than by a success (a fall), shape (episodes,)."""
    observation_low: NDArray[np.float64]
    """Smallest value of each component of the observation, shape (observation_size,)."""
    observation_high: NDArray[np.float64]
    """Largest value of each component of the observation, shape (observation_size,)."""

    def __post_init__(self) -> None:
        episodes = self.lengths.size
        bins = math.ceil(self.horizon / BIN_STEPS)
        low = self.observation_low
        high = self.observation_high
        fits = (
            1 <= self.horizon <= LONGEST_HORIZON
            and episodes >= 1
            and self.rewards.shape == (episodes, bins)
            and self.terminated.shape == self.lengths.shape == (episodes,)
            and low.ndim == 1
            and low.shape == high.shape
        )
        if not fits or self.lengths.min() < 1 or self.lengths.max() > self.horizon:
            raise PerdureError(f"the reference episodes over {self.horizon} steps do not fit together")
        finite = all(np.isfinite(each).all() for each in (self.rewards, low, high))
        if not finite or not (low <= high).all():
            raise PerdureError("the reference episodes hold numbers that are not finite or an empty observation range")

    @property
    def returns(self) -> NDArray[np.float64]:
        """Undiscounted return of each episode, shape (episodes,)."""
        total: NDArray[np.float64] = self.rewards.sum(axis=1)
        return total

    @property
    def rate(self) -> float:
        """Mean reward of a step that was made, over all episodes."""
        return float(self.rewards.sum() / self.lengths.sum())


def measure_reference(
    policy: PolicyLike,
    episodes: int = EPISODES,
    world: World | None = None,
    observe: Callable[[LoopStep], None] = lambda loop_step: None,
) -> Reference:
    """Run a policy within its training horizon, in this process, and return what it did.

    Args:
        policy: Acts with its mean; if it has a time-to-go input, its clock counts down as in training.
        episodes: How many, each from a different start state.
        world: Where to run, one lane for each episode; it is closed. By default the policy's own task.
        observe: Called with each step.

    Raises:
        PerdureError: If the policy does not fit the world, or an episode starts with an observation that is not finite.
    """
    world = world or make_world(policy.task.name, [FIRST_SEED + k for k in range(episodes)])
    try:
        horizon = world.spec.default_horizon
        if math.isfinite(policy.training_horizon):
            horizon = int(policy.training_horizon)
        loop = ClosedLoop(world, [EpisodePolicy(policy, _training_clock(policy, horizon))] * episodes)
        first = loop.observations
        low = first.min(axis=0)
        high = first.max(axis=0)
        scale = np.tile(policy.observation_std, (episodes, 1))
        detector = DivergenceDetector(first, scale, world.spec.hides_divergence)
        rewards = np.zeros((episodes, math.ceil(horizon / BIN_STEPS)))
        lengths = np.full(episodes, horizon)
        terminated = np.zeros(episodes, np.bool_)
        with one_thread(), np.errstate(over="ignore"):
            for step in range(horizon):
                loop_step = loop.advance()
                observe(loop_step)
                result = loop_step.step
                # What the engine made up after a divergence does not count.
                valid = ~detector.diverged(loop_step)
                rewards[loop_step.episodes[valid], step // BIN_STEPS] += result.rewards[valid]
                if valid.any():
                    low = np.minimum(low, result.observations[valid].min(axis=0))
                    high = np.maximum(high, result.observations[valid].max(axis=0))
                # Which episodes ended, and how: a success is no fall.
                if not valid.all():
                    loop.drop(loop_step.episodes[~valid])
                ended = result.ended | ~valid
                lengths[loop_step.episodes[ended]] = step + 1
                fell = result.terminated
                if result.successes is not None:
                    fell = fell & (result.successes != 1.0)
                terminated[loop_step.episodes[ended]] = fell[ended]
                if not len(loop.running):
                    break
        if not np.isfinite(rewards).all():
            raise PerdureError(f"{world.spec.name}: rewards within the training horizon add up to {rewards.sum()}")
    finally:
        world.close()
    return Reference(horizon, rewards, lengths, terminated, low, high)


def _training_clock(policy: PolicyLike, horizon: int) -> Clock | None:
    """Return a clock that counts down as in training; None for a policy without a time-to-go input."""
    if not policy.has_clock:
        return None
    own = getattr(policy, "clock", None)
    embedding = getattr(getattr(policy, "protocol", None), "embedding", None)
    if isinstance(own, Countdown) and isinstance(embedding, TimeFeature):  # an imported 1 - t/N: N is not T
        return own
    return Countdown(float(horizon))


def resolve_training_horizon(spec: TaskSpec, given: int | None) -> int:
    """Return the steps of a training episode: those given, otherwise the environment's step limit.

    Warns with a PerdureWarning where there is neither: `TaskSpec.default_horizon` is then assumed.

    Raises:
        PerdureError: If fewer than 1 are given.
    """
    if given is not None and not 1 <= given <= LONGEST_HORIZON:
        raise PerdureError(f"training_horizon must be from 1 to {LONGEST_HORIZON:,}, got {given}")
    if given is None and not spec.has_step_limit:
        warn(
            f"{spec.name} has no step limit; its training horizon is taken to be {spec.default_horizon:,} steps. "
            "Name yours with --training-horizon (training_horizon=)"
        )
    return given or spec.default_horizon
