"""Format numbers for readers."""

from __future__ import annotations

import math
from collections.abc import Sequence

from perdure.horizon import Clock


def whole(value: float) -> str:
    """Format 100000 as "100,000", and infinity and nan in words."""
    if math.isnan(value):
        return "unknown"
    return f"{value:,.0f}" if math.isfinite(value) else "\u221e"


def share(value: float) -> str:
    """Format 0.833 as "83 %". Only 1 becomes 100 % and only 0 becomes 0 %."""
    if math.isnan(value):
        return "\u2013"
    text = f"{100.0 * value:.0f}"
    if text == "100" and value < 1.0:
        return "> 99 %"
    if text == "0" and value > 0.0:
        return "< 1 %"
    return f"{text} %"


def quantity(value: float) -> str:
    """Write a return or a reward with the digits that matter: 293104.2 -> "293,104", 2.934 -> "2.93"."""
    if not math.isfinite(value):
        return "\u2013"
    size = abs(value)
    digits = 0 if size >= 1000 else 1 if size >= 100 else 2 if size >= 1 or size == 0 else 3
    text = f"{value:,.{digits}f}"
    return "\u2212" + text[1:] if text.startswith("-") else text


def clock(kind: str, steps: str) -> str:
    """Return the clock in words: "constant", "500" -> "always 500 steps to go"."""
    found = Clock.kinds().get(kind)
    if found is None or not found.words:  # of a package that is not installed here
        return f"{kind} {steps}"
    return found.words.format(steps)


def sample(counts: Sequence[int], noun: str) -> str:
    """Return the sample size in words: [6, 6], "episode" -> "n = 6 episodes each"; [4, 6] -> "n = 4 to 6 episodes"."""
    least = min(counts)
    most = max(counts)
    if least < most:
        return f"n = {least:,} to {count(most, noun)}"
    return f"n = {count(most, noun)}" + (" each" if len(counts) > 1 else "")


def count(number: int, noun: str) -> str:
    """Format (1, "episode") as "1 episode" and (3, "episode") as "3 episodes"."""
    return f"{number:,} {noun}" if number == 1 else f"{number:,} {noun}s"


def duration(hours: float) -> str:
    """Format 20.0 as "20 h", 4.0 as "4.0 h" and 0.05 as "3.0 min"."""
    unit, size = next(((u, s) for u, s in (("h", 1.0), ("min", 1 / 60)) if hours >= s), ("s", 1 / 3600))
    value = hours / size
    return f"{value:.1f} {unit}" if value < 10.0 else f"{value:,.0f} {unit}"
