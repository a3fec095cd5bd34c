"""How numbers are written for people."""

from __future__ import annotations

import math


def whole(value: float) -> str:
    """100000 -> "100,000"; infinity and nan in words."""
    if math.isnan(value):
        return "unknown"
    return f"{value:,.0f}" if math.isfinite(value) else "\u221e"


def share(value: float) -> str:
    """0.833 -> "83 %". Only all is 100 % and only none is 0 %."""
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


def short(value: float) -> str:
    """Axis labels: 100000 -> "100k", 2.5e6 -> "2.5M"."""
    for size, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if abs(value) >= size:
            return f"{value / size:g}{letter}".replace("-", "\u2212")
    return f"{value:g}".replace("-", "\u2212")


def horizon(value: float) -> str:
    """Say what the training horizon was."""
    if math.isnan(value):
        return "the training horizon is unknown"
    return f"{whole(value)} steps was the training horizon" if math.isfinite(value) else "it was trained without an end"


def count(number: int, noun: str) -> str:
    """1, "lane" -> "1 lane"; 3, "lane" -> "3 lanes"."""
    return f"{number:,} {noun}" if number == 1 else f"{number:,} {noun}s"
