"""The verdict on each policy and clock, and its text at the top of the page.

Each episode has an outcome in the table. The verdict on a group of episodes is *holds* if at least HOLDING_SHARE of the
episodes hold. Otherwise it is the most common other outcome.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from perdure.report import wording
from perdure.report.groups import ROUNDING, BoolArray, Group
from perdure.report.statistics import DEFAULT, Bootstrap, Interval, survival_interval

HOLDING_SHARE = 0.9
"""Share of its episodes that must hold for a policy to hold."""
MOTIONLESS = 0.02
"""Movement per step, in training standard deviations, below which a robot is called nearly motionless."""
MUCH = 2.0
"""Movement counts as changed if its ratio, last to first tenth of the steps, exceeds MUCH or is below 1 / MUCH."""
FAILURES = ("falls", "fails silently", "decays", "diverges", "never worked", "cannot tell")
"""Verdicts other than "holds"; of two equally common ones, the earlier is taken."""
_MOST_NAMED = 6
_MOST_LISTED = 20
"""Most training runs whose seeds are listed."""


@dataclass(frozen=True)
class Verdict:
    """The verdict on a group of episodes."""

    group: Group
    label: str
    """"holds" or one of FAILURES."""
    count: int
    """Episodes of that verdict."""
    share: Interval
    """Share of the episodes that hold, shape ()."""
    by_training_seed: Mapping[int, str]
    """The label of each training run by itself; empty where there is only one."""
    evidence: str
    """In words; "" where there is none."""

    @property
    def short(self) -> str:
        """Who, and the verdict: "ppo: falls in 4 of 10 episodes"."""
        group = self.group
        if self.label == "holds":
            return f"{group.label}: holds for {wording.whole(float(group.test_horizon))} steps"
        counted = "" if self.count == group.lanes else f" in {self.count} of {wording.count(group.lanes, 'episode')}"
        return f"{group.label}: {self.label}{counted}"

    @property
    def sentence(self) -> str:
        """Who, the verdict, how many episodes, and the evidence."""
        low, high = float(self.share.lower), float(self.share.upper)
        counted = ""
        if self.label == "holds" or self.count == self.group.lanes:
            counted = f" in {self.count} of {wording.count(self.group.lanes, 'episode')}"
        if self.label == "holds" and low < high:
            counted += f" (95 % interval {wording.share(low)} to {wording.share(high)})"
        elif self.label == "holds" and low == high:  # runs without a difference show no spread, which is no certainty
            counted += f" (the same share in each of {self.share.count} training runs)"
        return f"{self.short}{counted}" + (f"; {self.evidence}." if self.evidence else ".") + self._training_seeds

    @property
    def _training_seeds(self) -> str:
        """Which training runs hold: " By training seed: holds 0, 3; falls 1, 2."; "" where there is only one."""
        seeds: dict[str, list[int]] = {}
        for seed, label in sorted(self.by_training_seed.items()):
            seeds.setdefault(label, []).append(seed)
        parts = [
            f"{label} {', '.join(map(str, seeds[label]))}"
            if len(self.by_training_seed) <= _MOST_LISTED
            else f"{label} {len(seeds[label])} of {len(self.by_training_seed)}"
            for label in ("holds", *FAILURES)
            if label in seeds
        ]
        return f" By training seed: {'; '.join(parts)}." if parts else ""


def judge(group: Group, rng: np.random.Generator, how: Bootstrap = DEFAULT) -> Verdict:
    """Return the verdict on a group of episodes."""
    counts = Counter(group.verdicts)
    holding = np.array([verdict == "holds" for verdict in group.verdicts])
    share = survival_interval(holding.astype(np.float64), group.runs, rng, how)
    label = _label(counts, float(share.estimate))
    return Verdict(group, label, counts[label], share, _by_training_seed(group), _evidence(group, label))


def _label(counts: Mapping[str, int], holding: float) -> str:
    """Return the verdict on episodes: how many had which outcome, and the share of them that hold."""
    if holding >= HOLDING_SHARE - ROUNDING:
        return "holds"
    return max(FAILURES, key=lambda each: (counts.get(each, 0), -FAILURES.index(each)))


def _by_training_seed(group: Group) -> dict[int, str]:
    if len(set(group.runs.tolist())) < 2:
        return {}
    found: dict[int, Counter[str]] = {}
    for seed, verdict in zip(group.train_seeds.tolist(), group.verdicts, strict=True):
        found.setdefault(seed, Counter())[verdict] += 1
    return {seed: _label(counts, counts["holds"] / counts.total()) for seed, counts in found.items()}


def headline(verdicts: Sequence[Verdict]) -> str:
    """Return the verdict on every policy and clock of one task; if there are many, counts of each verdict.

    Args:
        verdicts: At least one, all of one task.
    """
    first = f"{verdicts[0].group.task}: "
    if all(verdict.label == "never worked" for verdict in verdicts):
        return first + "no policy works, even within its training horizon"
    if len(verdicts) <= _MOST_NAMED:
        return first + "; ".join(verdict.short for verdict in verdicts)
    counts = Counter(verdict.label for verdict in verdicts)
    parts = [f"{label} {counts[label]}" for label in ("holds", *FAILURES) if counts[label]]
    return f"{first}{len(verdicts)} policies and clocks: {', '.join(parts)}"


def _evidence(group: Group, label: str) -> str:
    mine = np.array([verdict == label for verdict in group.verdicts])
    if not mine.any():
        return ""
    if label in ("never worked", "cannot tell"):
        notes = Counter(note for note, chosen in zip(group.notes, mine, strict=True) if chosen and note)
        return notes.most_common(1)[0][0] if notes else ""
    if label == "holds":
        if group.only_survival:
            return "every step pays the same, so only survival is judged"
        rate = wording.share(float(group.end_hold[mine].mean()))
        paused = int(group.ever_idle[mine].sum())
        pauses = f"; {paused} of them fell below a quarter of it for a while" if paused else ""
        return f"gain over an idle robot at the end: {rate} of that in training{pauses}"
    middle = float(np.median(group.failed_steps[mine]))
    parts = [f"since step {wording.whole(middle)} (median)" if middle else "from the start"]
    if label == "fails silently":
        parts += _instead(group, mine)
    details = Counter(
        detail.split(" left ")[0] for detail, chosen in zip(group.end_details, mine, strict=True) if chosen
    )
    detail, number = details.most_common(1)[0]
    if detail.startswith("observation[") and number > 1:
        parts.append(f"{detail} was the first to leave its training range in {number}")
    elif label == "diverges" and detail:
        parts.append(detail.split(";")[0])
    return "; ".join(parts)


def _instead(group: Group, failed: BoolArray) -> list[str]:
    """Return the behavior of robots that fail silently, with counts, as text."""
    last, first = group.movement_last[failed], group.movement_first[failed]
    early = group.failed_steps[failed] < 0.1 * group.test_horizon
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = last / first
    kinds = np.select(
        [np.isnan(last), last < MOTIONLESS, early, ratio < 1 / MUCH, ratio > MUCH],
        ["", "nearly motionless", "moving", "moving less than before", "moving more than before"],
        "moving as much as before",
    )
    kind, number = Counter(kinds.tolist()).most_common(1)[0]
    worse = int((group.end_hold[failed] < -0.05).sum())
    parts = [(kind, number)] * bool(kind) + [("earning less than an idle robot", worse)] * bool(worse)
    return [what if count == len(last) else f"{what} in {count} of {len(last)}" for what, count in parts]
