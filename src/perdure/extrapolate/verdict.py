"""What became of each lane: it holds, decays, fails silently, falls or diverges, and since when."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from perdure.extrapolate.score import FEWEST_WINDOWS, HOLDS_FROM, IDLE_BELOW, ScoreScale

Outcome = Literal["holds", "decays", "fails silently", "falls", "diverges", "cut", "unknown"]
"""cut: the environment itself ended the episode for a reason that is not a failure; unknown: cannot be judged."""

MOSTLY = 0.9
"""A failure began with the first window from which on at least this share of windows is bad."""
LAST = 0.1
"""Share of the windows, at the end, whose mean score is the score at the end."""


@dataclass(frozen=True)
class LaneVerdict:
    """The verdict of one lane."""

    outcome: Outcome
    failed_step: int
    """Steps completed before the failure began; for a lane that has not failed, the steps it was watched."""
    end_hold: float
    """Hold score at the end, or before the lane ended; nan where there is no whole window."""
    ever_idle: bool
    """Two windows in a row were no better than idle, at any time."""


def judge_lane(
    steps: NDArray[np.int64], returns: NDArray[np.float64], end_step: int, end_reason: str, score_scale: ScoreScale
) -> LaneVerdict:
    """Judge a lane.

    Args:
        steps: Rising step numbers, shape (m,), evenly spaced; the last one is the test horizon.
        returns: Sum of rewards up to each, shape (m,).
        end_step: Steps the lane lasted.
        end_reason: "survived", "terminated", "truncated" or "diverged".
        score_scale: The measure of the lane's policy.
    """
    begins, scores = window_scores(steps, returns, end_step, score_scale)
    ended: dict[str, Outcome] = {"terminated": "falls", "diverged": "diverges", "truncated": "cut"}
    if score_scale.state != "worked":
        return LaneVerdict(ended.get(end_reason, "unknown"), end_step, float("nan"), False)
    idle = scores < IDLE_BELOW
    ever = bool((idle[1:] & idle[:-1]).any())
    last = float(scores[-max(1, round(LAST * len(scores))) :].mean()) if len(scores) else float("nan")
    silent = _since(idle, begins) if len(scores) and last < IDLE_BELOW else None
    if end_reason in ended:
        return LaneVerdict(ended[end_reason], end_step if silent is None else silent, last, ever)
    if len(scores) < FEWEST_WINDOWS:
        return LaneVerdict("unknown", end_step, last, ever)
    if last < IDLE_BELOW:
        return LaneVerdict("fails silently", silent if silent is not None else int(begins[-1]), last, ever)
    if last < HOLDS_FROM:
        since = _since(scores < HOLDS_FROM, begins)
        return LaneVerdict("decays", since if since is not None else int(begins[-1]), last, ever)
    return LaneVerdict("holds", end_step, last, ever)


def window_scores(
    steps: NDArray[np.int64], returns: NDArray[np.float64], end_step: int, score_scale: ScoreScale
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return (steps before it, hold score) of each whole window of a lane, in the order of time.

    Windows are laid from the lane's end backwards, so what is left over lies at the start, where a robot may still be
    on its way to its usual gait.
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
    return steps[marks][:-1], score_scale.hold(np.diff(returns[marks]) / width)


def _since(bad: NDArray[np.bool_], begins: NDArray[np.int64]) -> int | None:
    """Return where the first bad window begins from which on windows are mostly bad; None if there is none."""
    share = np.cumsum(bad[::-1])[::-1] / np.arange(len(bad), 0, -1)
    found = np.flatnonzero(bad & (share >= MOSTLY))
    return int(begins[found[0]]) if len(found) else None
