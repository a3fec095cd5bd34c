"""Scores of an episode's windows, and the numbers that the rules of outcomes read from them.

A window is a stretch of steps; its score against the policy's own training is 0 for an idle robot and 1 for the policy
within its training horizon. Windows are laid from the episode's end backwards, so what is left over lies at the start,
where a robot may still be on its way to its usual gait.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

IDLE_BELOW = 0.25
"""A window with a lower score against the policy's own training counts as idle."""
HOLDS_FROM = 0.75
"""Least mean score of the last windows of an episode that holds; between IDLE_BELOW and this it decays. See also
`holds_from`."""
FEWEST_JUDGED = 4
"""An episode must hold as many windows after settling, or none of it can be judged."""
MOSTLY = 0.9
"""A failure begins with the first window after which at least this share of the windows is bad."""
LAST = 0.1
"""Share of the windows that give the final score: the last ones, FEWEST_JUDGED at least."""
MEMORY = 5
"""The final score is averaged over MEMORY times the longest pause: the pause and four times its length."""
SURE = 2
"""A robot that paused before fails silently once it is idle for SURE times its longest earlier pause."""
ONE_SIDED = 1.645
"""Standard errors by which a mean must lie below the bound to exclude chance (normal, one-sided 95 %)."""
END_SURVIVED = "survived"
"""End reason of an episode that nothing ended."""


@dataclass(frozen=True, eq=False)
class EpisodeScores:
    """How an episode ended, and the scores of its windows in the order of time."""

    end_step: int
    """Steps the episode lasted."""
    end_reason: str
    """"survived", "terminated", "truncated" or "diverged"."""
    at_goal: bool
    """The environment reports a success at the last step."""
    worked: bool
    """Whether its policy works within its own training horizon; if not, scores are nan."""
    begins: NDArray[np.int64]
    """Steps before each window, shape (windows,)."""
    scores: NDArray[np.float64]
    """Score of each window against the policy's own training, shape (windows,)."""
    settling: int = 0
    """Steps at the start that the reference leaves out."""
    way_score: float = float("nan")
    """Score on the way to where the reference settles; nan: it settles at once."""

    @property
    def holds_from(self) -> float:
        """Least final score of an episode that holds."""
        return holds_from(self.way_score)

    @cached_property
    def idle(self) -> NDArray[np.bool_]:
        """Which windows are no better than an idle robot."""
        return self.scores < IDLE_BELOW

    @cached_property
    def settled(self) -> NDArray[np.bool_]:
        """Which windows begin after the start from rest."""
        return self.begins >= self.settling

    @property
    def ever_idle(self) -> bool:
        """Whether two consecutive windows after settling were idle."""
        idle = self.idle[self.settled]
        return bool((idle[1:] & idle[:-1]).any())

    @property
    def low_share(self) -> float:
        """Share of the windows after settling that score too low for an episode that holds; nan without a window."""
        scores = self.scores[self.settled]
        return float((scores < self.holds_from).mean()) if len(scores) else float("nan")

    @property
    def survived(self) -> bool:
        """Whether nothing ended the episode."""
        return self.end_reason == END_SURVIVED

    @property
    def comparable(self) -> bool:
        """Whether it survived, its policy works, and there are enough windows to compare it with its training."""
        return self.survived and self.worked and int(self.settled.sum()) >= FEWEST_JUDGED

    @property
    def last_count(self) -> int:
        """Number of windows that give the final score."""
        return min(len(self.scores), max(FEWEST_JUDGED, round(LAST * len(self.scores))))

    @cached_property
    def last(self) -> float:
        """Mean score of the last tenth of the windows; nan where there is no window."""
        return float(self.scores[-self.last_count :].mean()) if self.last_count else float("nan")

    @cached_property
    def silent(self) -> int:
        """Number of the window with which a silent failure begins; that of the windows if there is none."""
        return since(self.scores, IDLE_BELOW) if self.last < IDLE_BELOW else len(self.scores)

    @property
    def silent_step(self) -> int:
        """Steps before a silent failure; without one all steps."""
        return int(self.begins[self.silent]) if self.silent < len(self.scores) else self.end_step

    @cached_property
    def pause(self) -> int:
        """Length in windows of the longest pause, which the robot recovered from."""
        return _longest(self.idle[: self.silent])

    @property
    def final(self) -> NDArray[np.float64]:
        """Windows over which the final score is averaged: the last ones, more if the robot pauses."""
        return self.scores[-max(self.last_count, MEMORY * self.pause) :]

    @property
    def silent_for_good(self) -> bool:
        """Whether the robot is idle at the end, and for longer than it pauses."""
        if not self.last < IDLE_BELOW:
            return False
        outlasts = len(self.scores) - self.silent >= SURE * self.pause
        return outlasts or bool(self.final.mean() < IDLE_BELOW)

    @cached_property
    def decayed(self) -> bool | None:
        """Whether the last windows are significantly below `holds_from`; None if there are too few to tell."""
        settled = self.scores[self.settled]
        return _decayed(settled, min(len(self.final), len(settled)), self.holds_from)

    @property
    def decay_step(self) -> int:
        """Steps before a decay."""
        return int(self.begins[since(self.scores, self.holds_from)])


def holds_from(way_score: float) -> float:
    """Return the least final score of an episode that holds.

    Where the way earns nearly as much as the goal, against an idle robot, an episode must be clearly better than on its
    way: an idle drone falls, and one that climbs for ever earns nearly as much as one that hovers.

    Args:
        way_score: Score on the way to where the reference settles; nan: it settles at once.
    """
    if np.isnan(way_score):
        return HOLDS_FROM
    return max(HOLDS_FROM, way_score + IDLE_BELOW * (1.0 - way_score))


def since(scores: NDArray[np.float64], bound: float) -> int:
    """Return the first window below a bound from which on windows mostly are, or else are on average."""
    bad = scores < bound
    left = np.arange(len(scores), 0, -1)
    mostly = bad & (np.cumsum(bad[::-1])[::-1] / left >= MOSTLY)
    if not mostly.any():
        mostly = bad & (np.cumsum(scores[::-1])[::-1] / left < bound)
    found = np.flatnonzero(mostly)
    return int(found[0]) if len(found) else len(scores) - 1


def _decayed(scores: NDArray[np.float64], count: int, least: float) -> bool | None:
    """Return whether the last windows are significantly below a bound; None if there are too few windows.

    Args:
        scores: Of an episode.
        count: Windows to begin with; doubled until the verdict is clear.
        least: The bound.
    """
    while True:
        part = scores[-count:]
        mean = float(part.mean())
        error = float(part.std(ddof=1)) / len(part) ** 0.5
        if mean >= least:
            return False
        if mean + ONE_SIDED * error < least:
            return True
        if count >= len(scores):
            return None
        count *= 2


def _longest(idle: NDArray[np.bool_]) -> int:
    """Return the length of the longest run of idle windows that another window follows."""
    edges = np.diff(np.concatenate([[0], idle]))
    begins = np.flatnonzero(edges == 1)
    ends = np.flatnonzero(edges == -1)
    return int(np.max(ends - begins[: len(ends)], initial=0))
