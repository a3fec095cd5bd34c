"""Score scale of a policy (0: an idle robot, 1: its own training horizon), and the verdict on each episode.

One normalized score of a stretch of steps, similar to D4RL's (Fu et al., 2020), with a named reference. It does not
depend on the unit or the offset of the reward:

    score = (rate - idle) / (reference rate - idle)    0: an idle robot; 1: the reference

    score against its own training         reference: the policy within its training horizon; gives the verdict
    score against a published policy       reference: a published policy of the task; compares policies and methods

`rate` is the mean reward per step before a fall. Falls are counted separately, because a robot that dives forward has a
high rate until it falls.

Scores of short stretches are noisy if rewards are rare or periodic. The windows are therefore so long that windows of
the reference rarely score as idle.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from perdure.evaluate.reference import Idle
from perdure.evaluate.settling import settle
from perdure.policy.reference import BIN_STEPS, Reference
from perdure.report.outcomes import WORKED, CannotTell, NeverWorked, judging_order
from perdure.report.scores import IDLE_BELOW, EpisodeScores, holds_from

FALSE_ALARMS = 0.05
"""Share of reference windows that may score below IDLE_BELOW; windows grow until it is not exceeded."""
LEAST_SCORE = 0.05
"""A policy whose score against a published policy, if one is known, is lower has never worked."""
LEAST_GAIN = 0.25
"""A policy has also never worked if its gain over the idle robot is less than this share of the difference between zero
and random actions (a contract: or of what is left to gain). If no published policy is known, nothing else counts."""
IDLE_IS_BEST = 0.95
"""A contract, which pays at most 1 a step, is judged by survival if an idle robot earns more: told to stand."""
LEAST_SURVIVAL = 0.5
"""Where survival is judged, a policy has never worked if its episodes end before this share of the horizon."""
FEWEST_REFERENCE_WINDOWS = 4
"""Windows within the reference episodes from which their length can be chosen."""
_DRAWS = 400

PUBLISHED_RATES = {
    "Ant": 4.079,
    "HalfCheetah": 7.337,
    "Hopper": 3.128,
    "Humanoid": 10.339,  # ATRPO in nnabla-rl (3 seeds, v3)
    "Swimmer": 0.367,  # croumegous/ppo-Swimmer-v3 on Hugging Face
    "Walker2d": 4.896,
}
"""Reward per step of published policies: returns of 1,000 steps / 1,000. Where nothing else is named: PPO in
Tianshou's benchmark after 3,000,000 steps (10 seeds, v3, deterministic)."""
_ROBOTS = re.compile(rf"(?:gymnasium:|envpool:)?({'|'.join(PUBLISHED_RATES)})-v[2-5]")
"""Names of these tasks in EnvPool and Gymnasium. A name with a module, such as "gymnasium:my_env:Hopper-v0", is a
different environment, of which no published policy is known."""


def published_rate(task: str) -> float:
    """Return the reward per step of a published policy of a task, such as "Hopper-v3"; nan where none is known."""
    found = _ROBOTS.fullmatch(task)
    return PUBLISHED_RATES[found[1]] if found else math.nan


@dataclass(frozen=True)
class ScoreScale:
    """The rates that a policy's rewards are compared with, in reward per step."""

    idle_rate: float
    training_rate: float
    published_rate: float
    """nan where none is known."""
    window: int
    """Steps of the shortest window that passes its test; 0 where the policy has never worked."""
    policy_state: str
    """One of `POLICY_STATES`; "worked": within its own training horizon it earns more than an idle robot."""
    policy_note: str
    """The evidence in a sentence."""
    survival: bool = False
    """An idle robot earns as much, so the policy has worked if it lasts."""
    settling: int = 0
    """Steps at the start of an episode that the reference leaves out; 0 where it leaves out none."""
    training_falls: float = math.nan
    """Share of the reference episodes that the task ended within the training horizon; nan: unknown."""
    way_rate: float = math.nan
    """Reward per step on the way to where the reference settles; nan if that takes at most a tenth of the horizon."""
    training_low_share: float = math.nan
    """Share of the reference windows that score too low for an episode that holds."""

    idle_steps: float = math.nan
    """Mean steps that an idle robot lasts; nan: unknown."""
    other_engine: str = ""
    """In what the policy was trained and in what it is judged, if these differ."""

    @property
    def way_score(self) -> float:
        """Score on the way to where the reference settles; nan where `way_rate` is."""
        return float(self.score(np.array(self.way_rate)))

    def score(self, rate: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the score of rates against the policy's own training; nan for a policy that never worked."""
        if self.policy_state != WORKED:
            return np.full_like(rate, np.nan)
        if self.survival:
            return rate / self.training_rate
        return (rate - self.idle_rate) / (self.training_rate - self.idle_rate)


def make_score_scale(reference: Reference, idle: Idle, published: float, contract: bool = False) -> ScoreScale:
    """Compare reference episodes with an idle robot.

    Args:
        reference: Episodes within the training horizon.
        idle: What an idle robot earns.
        published: Reward per step of a published policy, or nan.
        contract: Whether the task is a robot's contract, which pays at most 1 a step: so much can be gained over idle.
    """
    falls = float((reference.terminated & (reference.lengths < reference.horizon)).mean())
    most = 1.0 if contract else math.inf
    if idle.rate > IDLE_IS_BEST * most or _pays_for_survival(reference, idle):
        return replace(_survival_scale(reference, idle, published), training_falls=falls)
    return replace(_rate_scale(reference, idle, published, most), training_falls=falls)


def _rate_scale(reference: Reference, idle: Idle, published: float, most: float) -> ScoreScale:
    """Judge a policy by the reward that it gains over an idle robot."""
    settling = settle(reference, lambda steps: _settled_rate(reference, steps).error)
    rate = _settled_rate(reference, settling.steps)
    gain = rate.mean - idle.rate
    least = LEAST_GAIN * min(abs(idle.zero - idle.random), most - idle.rate)
    if published > idle.rate:
        least = max(least, LEAST_SCORE * (published - idle.rate))
    note = (
        f"within its training horizon it earns {rate.mean:.3g} a step (± {rate.error:.2g}, {rate.episodes} episodes), "
        f"an idle robot {idle.rate:.3g} ({idle.kind})"
    )
    if not gain - rate.error > least:
        state = NeverWorked.name if gain <= least else CannotTell.name
        return ScoreScale(idle.rate, rate.mean, published, 0, state, f"{note}; a gain above {least:.3g} would count")
    window, scores = _window(reference, idle.rate, rate)
    scale = ScoreScale(idle.rate, rate.mean, published, window, WORKED, note, way_rate=settling.way_rate)
    low = float((scores < holds_from(scale.way_score)).mean())
    return replace(scale, settling=settling.steps, training_low_share=low)


def _pays_for_survival(reference: Reference, idle: Idle) -> bool:
    """Return whether every step pays the same, to the policy and to an idle robot, as in CartPole."""
    rates = reference.rewards.sum(axis=1) / reference.lengths
    same = np.isclose([idle.random, *rates], idle.zero, rtol=1e-9, atol=0.0)
    return bool(idle.zero > 0.0 and same.all())


def _survival_scale(reference: Reference, idle: Idle, published: float) -> ScoreScale:
    """Judge a policy by how long it lasts: it worked if its episodes last half of the training horizon on average."""
    share = float(reference.lengths.mean()) / reference.horizon
    note = (
        f"a step pays {idle.rate:.3g} even to an idle robot, so its training is judged by survival: it lasts "
        f"{share:.0%} of its training horizon on average ({reference.lengths.size} episodes)"
    )
    worked = share >= LEAST_SURVIVAL
    state = WORKED if worked else NeverWorked.name
    return ScoreScale(idle.rate, idle.rate, published, BIN_STEPS if worked else 0, state, note, survival=True)


@dataclass(frozen=True, eq=False)
class _Rate:
    """The rate of reference episodes after settling."""

    mean: float
    """Reward per step."""
    error: float
    """Half the width of Student's 95 % interval, episodes as units (linearized ratio); inf for one episode."""
    settling: int
    """Steps left out."""
    earned: NDArray[np.float64]
    """By each episode that lasted longer."""
    lived: NDArray[np.float64]
    """Steps of these episodes after settling."""

    @property
    def episodes(self) -> int:
        """Number of episodes."""
        return len(self.lived)


def _settled_rate(reference: Reference, settling: int) -> _Rate:
    """Return the rate of reference episodes without their first steps."""
    lived = np.maximum(reference.lengths - settling, 0).astype(np.float64)
    kept = lived > 0
    earned = reference.rewards[kept, settling // BIN_STEPS :].sum(axis=1)
    lived = lived[kept]
    mean = float(earned.sum() / lived.sum())
    return _Rate(mean, _ratio_error(earned, lived, mean), settling, earned, lived)


def _ratio_error(earned: NDArray[np.float64], lived: NDArray[np.float64], rate: float) -> float:
    """Return half the width of Student's 95 % interval of a rate, episodes as units (linearized ratio)."""
    if len(lived) < 2:
        return math.inf
    from scipy.special import stdtrit

    residual = (earned - rate * lived) / lived.mean()
    return float(stdtrit(len(lived) - 1, 0.975) * residual.std(ddof=1) / math.sqrt(len(lived)))


def _window(reference: Reference, idle: float, rate: _Rate) -> tuple[int, NDArray[np.float64]]:
    """Return the shortest window, in steps, whose scores within the reference hardly ever look idle, and these."""
    bins = 1
    while True:
        scores = (_window_rates(reference, rate.settling // BIN_STEPS, bins) - idle) / (rate.mean - idle)
        if len(scores) < FEWEST_REFERENCE_WINDOWS:
            return _window_of_episodes(rate, idle)
        if (scores < IDLE_BELOW).mean() <= FALSE_ALARMS:
            return bins * BIN_STEPS, scores
        bins *= 2


def _window_rates(reference: Reference, skip: int, bins: int) -> NDArray[np.float64]:
    """Return the reward per step of the reference's windows of so many bins, without the first bins of an episode."""
    rates = []
    for rewards, length in zip(reference.rewards, reference.lengths, strict=True):
        lived = rewards[skip : length // BIN_STEPS]
        count = len(lived) // bins
        rates.append(lived[: count * bins].reshape(count, bins).sum(axis=1) / (bins * BIN_STEPS))
    return np.concatenate(rates)


def _window_of_episodes(rate: _Rate, idle: float) -> tuple[int, NDArray[np.float64]]:
    """Return the same for windows longer than an episode, joined from random episodes."""
    rng = np.random.default_rng(0)
    episodes = 1
    while True:
        drawn = rng.integers(rate.episodes, size=(_DRAWS, episodes))
        rates = rate.earned[drawn].sum(axis=1) / rate.lived[drawn].sum(axis=1)
        scores = (rates - idle) / (rate.mean - idle)
        if (scores < IDLE_BELOW).mean() <= FALSE_ALARMS:
            return math.ceil(episodes * float(rate.lived.mean()) / BIN_STEPS) * BIN_STEPS, scores
        episodes *= 2


# Verdict: the outcome of each episode, and the step at which a failure began

MOST = 2.0
"""Upper limit of a window's score, so that a single large reward does not hide an idle robot."""


@dataclass(frozen=True)
class EpisodeVerdict:
    """The verdict of one episode."""

    outcome: str
    """A word of the table, see `perdure.report.outcomes`."""
    failed_step: int
    """Steps completed before the failure began; without a failure, all steps of the episode."""
    end_score_vs_training: float
    """At the end, or before the episode ended; nan where there is no whole window."""
    ever_idle: bool
    """Two consecutive windows were no better than idle, at any time."""
    low_share: float
    """Share of the windows after settling that score too low for an episode that holds; nan where there is none."""


def judge_episode(
    steps: NDArray[np.int64],
    returns: NDArray[np.float64],
    end_step: int,
    end_reason: str,
    score_scale: ScoreScale,
    at_goal: bool = False,
) -> EpisodeVerdict:
    """Return the verdict on an episode: the first outcome whose rule applies.

    Args:
        steps: Rising step numbers, shape (m,), evenly spaced; the last one is the test horizon.
        returns: Sum of rewards up to each, shape (m,).
        end_step: Steps the episode lasted.
        end_reason: "survived", "terminated", "truncated" or "diverged".
        score_scale: The measure of the episode's policy.
        at_goal: The environment reports a success at the last step. If it ends the episode there, rewards do not count.
    """
    begins, scores = window_scores(steps, returns, end_step, score_scale)
    worked = score_scale.policy_state == WORKED
    episode = EpisodeScores(
        end_step, end_reason, at_goal, worked, begins, scores, score_scale.settling, score_scale.way_score
    )
    outcome = next(each for each in judging_order() if each.applies(episode))
    if outcome.by_goal:
        return EpisodeVerdict(outcome.name, end_step, math.nan, False, math.nan)
    return EpisodeVerdict(
        outcome.name, outcome.failed_step(episode), episode.last, episode.ever_idle, episode.low_share
    )


def window_scores(
    steps: NDArray[np.int64], returns: NDArray[np.float64], end_step: int, score_scale: ScoreScale
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return (steps before it, score against training) of each whole window of an episode, in the order of time.

    Windows are laid from the episode's end backwards, so what is left over lies at the start, where a robot may still
    be on its way to its usual gait.
    """
    reached = np.flatnonzero(steps <= end_step)
    if not len(reached):
        return np.zeros(0, np.int64), np.zeros(0)
    steps = np.concatenate([[0], steps[reached]])
    returns = np.concatenate([[0.0], returns[reached]])
    spacing = int(np.diff(steps).max())
    stride = max(1, -(-score_scale.window // spacing))
    marks = np.arange(len(steps) - 1, -1, -stride)[::-1]
    width = np.diff(steps[marks])
    return steps[marks][:-1], np.minimum(score_scale.score(np.diff(returns[marks]) / width), MOST)
