"""Short rollouts: why a policy holds or falls (units of the stage "mechanism"), and a clock without a sweep ("clocks").

Mechanism: every episode has a horizon T drawn as in training (evenly over its distribution) and counts down to it.
Measured are the reward against the steps to go (thesis, 3.5.1: robots lurch forward at the end), and what the critic
explains (3.2.3).

The return to go of a step is what the critic was trained to predict: the sum of rewards up to the episode's horizon
where its end counts as terminated, the discounted sum without an end where it is bootstrapped. With gamma = 1 and a
bootstrap the value is determined only up to a constant, so there is nothing to compare.

    value variance  variance of (return to go - value) / variance of the returns to go; 0: all explained

The critic was trained on the noisy policy and is tested on its mean.
"""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from perdure.envs import make_world
from perdure.evaluate import EpisodeSpec, evaluate_episodes
from perdure.horizon import Clock, Constant, Countdown
from perdure.policy import ClosedLoop, EpisodePolicy, Policy, load_policy
from perdure.policy.network import one_thread
from perdure.runs import Work, write_atomic

RESULT = "result.json"
FIRST_SEED = 3_500_000
"""World seed of episode 0. Evaluation seeds, which begin at 1,000,000, never come here."""
ROLLOUTS = 8
WITHOUT_END = 1000.0
"""Steps that stand for a training horizon without an end."""
BIN = 50
"""Steps to go that are counted together; the bin 50 holds 1 to 50."""
LONGEST_TAIL = 1000
"""Steps after the horizon that a discounted return to go counts at most."""
NEGLIGIBLE_WEIGHT = 0.01
"""A reward this strongly discounted is left out."""
HALVING_SEEDS = 2
"""Start states of each candidate in each round of halving."""
HALVING_STEPS = 500
"""Steps in the first round."""
HALVING_SEED = 4000
"""First of the start states of halving, which no split uses."""

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Rollout:
    """n episodes for at most m steps. After an episode's end: rewards 0, observations nan."""

    observations: FloatArray
    """What was acted on, shape (m, n, observation size)."""
    rewards: FloatArray
    """Shape (m, n)."""
    lengths: NDArray[np.int64]
    """Steps each episode made, shape (n,)."""

    @property
    def made(self) -> NDArray[np.bool_]:
        """Which steps were made, shape (m, n)."""
        return np.arange(len(self.rewards))[:, None] < self.lengths[None, :]


def roll_out(policy: Policy, clocks: Sequence[Clock | None], steps: int) -> Rollout:
    """Run a policy in one episode for each clock, each from a different start state, without a horizon."""
    episodes = len(clocks)
    observations = np.full((steps, episodes, policy.task.observation_size), np.nan)
    rewards = np.zeros((steps, episodes))
    lengths = np.full(episodes, steps)
    with closing(make_world(policy.task.name, [FIRST_SEED + episode for episode in range(episodes)])) as world:
        loop = ClosedLoop(world, [EpisodePolicy(policy, clock) for clock in clocks])
        with one_thread():
            for step in range(steps):
                if not len(loop.running):
                    break
                moved = loop.advance()
                observations[step, moved.episodes] = moved.before
                rewards[step, moved.episodes] = np.nan_to_num(moved.step.rewards)
                lengths[moved.episodes[moved.step.ended]] = step + 1
    return Rollout(observations, rewards, lengths)


def draw_horizons(policy: Policy, episodes: int) -> NDArray[np.int64]:
    """Return training horizons, evenly over their distribution, shape (episodes,)."""
    drawn = np.asarray(policy.protocol.horizon.from_uniform((np.arange(episodes) + 0.5) / episodes), np.float64)
    return np.where(np.isfinite(drawn), drawn, WITHOUT_END).astype(np.int64)


def measure(work: Work, *, path: str) -> None:
    """Write the mechanism measures of one policy as [name, at, value], `at` null for those of the whole run."""
    policy = load_policy(path)
    horizons = draw_horizons(policy, ROLLOUTS)
    clocks: list[Clock | None] = [None] * ROLLOUTS
    if policy.protocol.embedding is not None:
        clocks = [Countdown(float(horizon)) for horizon in horizons]
    steps = int(horizons.max())
    if has_target(policy):
        steps += tail_steps(policy)
    rollout = roll_out(policy, clocks, steps)
    rows: list[list[Any]] = [["reward", *row] for row in rewards_to_go(rollout, horizons).iter_rows()]
    rows += [[name, None, value] for name, value in value_measures(policy, rollout, horizons).items()]
    write_atomic(work.folder / RESULT, json.dumps([row for row in rows if math.isfinite(row[2])]) + "\n")


def choose_clock(work: Work, *, path: str, candidates: list[float], most_steps: int) -> None:
    """Write the clock that successive halving finds, and the steps it took."""
    clock, steps = choose_by_halving(load_policy(path), [Constant(each) for each in candidates], most_steps)
    found = [{"rule": "bandit", "clock": f"constant:{clock.steps:.0f}", "simulated_steps": steps}]
    write_atomic(work.folder / RESULT, json.dumps(found) + "\n")


def bins_to_go(rollout: Rollout, horizons: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the bin of each step that was made within its episode's horizon, 0 for all others; shape (m, n)."""
    left = horizons[None, :] - np.arange(len(rollout.rewards))[:, None]
    bins: NDArray[np.int64] = np.where(rollout.made & (left > 0), -(-left // BIN) * BIN, 0)
    return bins


def rewards_to_go(rollout: Rollout, horizons: NDArray[np.int64]) -> pl.DataFrame:
    """Return the mean reward per step in each bin: columns "steps to go", "reward"."""
    bins = bins_to_go(rollout, horizons)
    frame = pl.DataFrame({"steps to go": bins.ravel(), "reward": rollout.rewards.ravel()})
    within = frame.filter(pl.col("steps to go") > 0)
    return within.group_by("steps to go").agg(pl.col("reward").mean()).sort("steps to go")


def has_target(policy: Policy) -> bool:
    """Return whether the value of a policy means a return that a rollout can measure.

    With a gamma of 0.999 and a bootstrap, rewards of the next 4,603 steps count: more than are simulated.
    """
    protocol = policy.protocol
    measurable = protocol.end == "terminated" or (protocol.gamma < 1.0 and tail_steps(policy) <= LONGEST_TAIL)
    return measurable and policy.has_critic and policy.return_scale is not None


def tail_steps(policy: Policy) -> int:
    """Return how many steps after the horizon a return to go needs."""
    protocol = policy.protocol
    if protocol.end == "terminated" or not 0.0 < protocol.gamma < 1.0:
        return 0
    return math.ceil(math.log(NEGLIGIBLE_WEIGHT) / math.log(protocol.gamma))


def returns_to_go(policy: Policy, rollout: Rollout, horizons: NDArray[np.int64]) -> FloatArray:
    """Return what was earned from each step on, shape (m, n)."""
    rewards = rollout.rewards
    if policy.protocol.end == "terminated":
        rewards = np.where(np.arange(len(rewards))[:, None] < horizons[None, :], rewards, 0.0)
    found = np.empty_like(rewards)
    following = np.zeros(rewards.shape[1])
    for step in range(len(rewards) - 1, -1, -1):
        following = rewards[step] + policy.protocol.gamma * following
        found[step] = following
    return found


def value_measures(policy: Policy, rollout: Rollout, horizons: NDArray[np.int64]) -> dict[str, float]:
    """Return "value variance"; nothing without a target."""
    if not has_target(policy):
        return {}
    within = bins_to_go(rollout, horizons) > 0
    elapsed = np.broadcast_to(np.arange(len(within), dtype=np.float64)[:, None], within.shape)[within]
    horizon = np.broadcast_to(horizons.astype(np.float64)[None, :], within.shape)[within]
    values = policy.value(rollout.observations[within], elapsed, horizon)
    returns = returns_to_go(policy, rollout, horizons)[within]
    if len(returns) < 2:
        return {}
    spread = float(returns.std())
    if spread == 0.0:
        return {}
    return {"value variance": float((returns - values).var()) / spread**2}


def choose_by_halving(policy: Policy, candidates: Sequence[Constant], most_steps: int) -> tuple[Constant, int]:
    """Choose C by successive halving with short rollouts; return it, and the steps simulated.

    Every candidate runs from a few start states for a short time; the better half runs again from new start states,
    twice as long, and so on until one is left [Karnin, Koren and Somekh, 2013, "Almost Optimal Exploration in
    Multi-Armed Bandits"; Jamieson and Talwalkar, 2016]. A fall costs: the score is the return by the steps asked for.

    Args:
        policy: With a time-to-go input.
        candidates: At least one, by rising C; of equally good ones the first stays.
        most_steps: No rollout is longer.
    """
    left = list(candidates)
    steps = min(HALVING_STEPS, most_steps)
    first_seed = HALVING_SEED
    made = 0
    while len(left) > 1:
        # A short rollout of each candidate from each start state.
        seeds = range(first_seed, first_seed + HALVING_SEEDS)
        episodes = [EpisodeSpec(0, clock, seed, steps=steps) for clock, seed in itertools.product(left, seeds)]
        records = evaluate_episodes([policy], episodes)
        made += int(records.end_step.sum())
        # The better half stays, in its order.
        earned = records.returns[:, -1].reshape(len(left), HALVING_SEEDS).mean(axis=1)
        keep = sorted(range(len(left)), key=lambda k: -earned[k])[: (len(left) + 1) // 2]
        left = [left[k] for k in sorted(keep)]
        steps = min(2 * steps, most_steps)
        first_seed += HALVING_SEEDS
    return left[0], made
