"""Outcome of each episode (holds, decays, falls, reaches its goal, ...), and the step at which a failure began."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from perdure.evaluate.score import FEWEST_WINDOWS, HOLDS_FROM, IDLE_BELOW, ScoreScale

Outcome = Literal["holds", "decays", "fails silently", "falls", "diverges", "reaches its goal", "cut", "unknown"]
"""cut: the environment itself ended the episode for a reason that is not a failure; unknown: cannot be judged."""

MOSTLY = 0.9
"""A failure begins with the first window after which at least this share of the windows is bad."""
LAST = 0.1
"""Share of the windows that give the final score: the last ones, FEWEST_WINDOWS at least."""
MEMORY = 5
"""The final score is averaged over MEMORY times the longest pause: the pause and four times its length."""
SURE = 2
"""A robot that paused before fails silently once it is idle for SURE times its longest earlier pause."""
ONE_SIDED = 1.645
"""Standard errors by which a mean must lie below HOLDS_FROM to exclude chance (normal, one-sided 95 %)."""
MOST = 2.0
"""Upper limit of a window's score, so that a single large reward does not hide an idle robot."""


@dataclass(frozen=True)
class EpisodeVerdict:
    """The verdict of one episode."""

    outcome: Outcome
    failed_step: int
    """Steps completed before the failure began; without a failure, all steps of the episode."""
    end_score_vs_training: float
    """At the end, or before the episode ended; nan where there is no whole window."""
    ever_idle: bool
    """Two consecutive windows were no better than idle, at any time."""


def judge_episode(
    steps: NDArray[np.int64],
    returns: NDArray[np.float64],
    end_step: int,
    end_reason: str,
    score_scale: ScoreScale,
    at_goal: bool = False,
) -> EpisodeVerdict:
    """Return the verdict on an episode.

    Args:
        steps: Rising step numbers, shape (m,), evenly spaced; the last one is the test horizon.
        returns: Sum of rewards up to each, shape (m,).
        end_step: Steps the episode lasted.
        end_reason: "survived", "terminated", "truncated" or "diverged".
        score_scale: The measure of the episode's policy.
        at_goal: The environment reports a success at the last step. If it ends the episode there, rewards do not count.
    """
    if at_goal and end_reason in ("terminated", "truncated"):
        return EpisodeVerdict("reaches its goal", end_step, float("nan"), False)
    begins, scores = window_scores(steps, returns, end_step, score_scale)
    ended: dict[str, Outcome] = {"terminated": "falls", "diverged": "diverges", "truncated": "cut"}
    if score_scale.policy_state != "worked":
        return EpisodeVerdict(ended.get(end_reason, "unknown"), end_step, float("nan"), False)
    count = min(len(scores), max(FEWEST_WINDOWS, round(LAST * len(scores))))
    last = float(scores[-count:].mean()) if count else float("nan")
    idle = scores < IDLE_BELOW
    ever = bool((idle[1:] & idle[:-1]).any())
    silent = _since(scores, IDLE_BELOW) if last < IDLE_BELOW else len(scores)
    if end_reason in ended:
        failed = int(begins[silent]) if silent < len(scores) else end_step
        return EpisodeVerdict(ended[end_reason], failed, last, ever)
    # The reference leaves the start from rest out; a mean that includes it would be too low.
    settled = scores[begins >= score_scale.settling]
    if len(settled) < FEWEST_WINDOWS:
        return EpisodeVerdict("unknown", end_step, last, ever)
    pause = _longest(idle[:silent])
    span = scores[-max(count, MEMORY * pause) :]
    if last < IDLE_BELOW and (len(scores) - silent >= SURE * pause or span.mean() < IDLE_BELOW):
        return EpisodeVerdict("fails silently", int(begins[silent]), last, ever)
    decayed = _decayed(settled, min(len(span), len(settled)))
    if decayed is None:
        return EpisodeVerdict("unknown", end_step, last, ever)
    if decayed:
        return EpisodeVerdict("decays", int(begins[_since(scores, HOLDS_FROM)]), last, ever)
    return EpisodeVerdict("holds", end_step, last, ever)


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


def _since(scores: NDArray[np.float64], bound: float) -> int:
    """Return the first window below a bound from which on windows mostly are, or else are on average."""
    bad, left = scores < bound, np.arange(len(scores), 0, -1)
    mostly = bad & (np.cumsum(bad[::-1])[::-1] / left >= MOSTLY)
    if not mostly.any():
        mostly = bad & (np.cumsum(scores[::-1])[::-1] / left < bound)
    found = np.flatnonzero(mostly)
    return int(found[0]) if len(found) else len(scores) - 1


def _decayed(scores: NDArray[np.float64], count: int) -> bool | None:
    """Return whether the last windows are significantly below HOLDS_FROM; None if there are too few windows.

    Args:
        scores: Of an episode.
        count: Windows to begin with; doubled until the verdict is clear.
    """
    while True:
        part = scores[-count:]
        mean, error = float(part.mean()), float(part.std(ddof=1)) / len(part) ** 0.5
        if mean >= HOLDS_FROM:
            return False
        if mean + ONE_SIDED * error < HOLDS_FROM:
            return True
        if count >= len(scores):
            return None
        count *= 2


def _longest(idle: NDArray[np.bool_]) -> int:
    """Return the length of the longest run of idle windows that another window follows."""
    edges = np.diff(np.concatenate([[0], idle]))
    begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return int(np.max(ends - begins[: len(ends)], initial=0))
