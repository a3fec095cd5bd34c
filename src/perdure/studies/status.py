"""Remaining time and progress of a study, read from its stores, also while another process runs it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from perdure.studies.study import Count, Step


@dataclass(frozen=True)
class Line:
    """Summary of the steps of one stage."""

    stage: str
    steps: int
    count: Count
    amount: float
    """All the work."""
    left: float
    """The work that is left, in the same measure."""
    measure: str
    hours: float
    """Hours on the given cores for what is left; nan where no speed is known."""


def count_steps(steps: Sequence[Step]) -> dict[str, Count]:
    """Return how far each step is, by its key."""
    return {step.key: step.count() for step in steps}


def lines(
    steps: Sequence[Step], counts: Mapping[str, Count], speeds: Mapping[str, float] | None = None, cores: int = 1
) -> list[Line]:
    """Return the stages in their order.

    Args:
        steps: Of the study.
        counts: From `count_steps`.
        speeds: Lane steps a second of one core for each task; None: hours are not known.
        cores: That work at the same time.
    """
    found = []
    for stage in dict.fromkeys(step.stage for step in steps):
        members = [step for step in steps if step.stage == stage]
        of = [counts[step.key] for step in members]
        total = sum(each.total for each in of)
        amount = sum(step.amount for step in members)
        left = sum(step.amount * (1.0 - each.share) for step, each in zip(members, of, strict=True))
        count = Count(
            total,
            sum(each.done for each in of),
            sum(each.running for each in of),
            sum(each.failed for each in of),
            1.0 - left / amount if amount else 1.0,
        )
        hours = sum(_hours(step, counts[step.key], speeds) for step in members) / cores
        found.append(Line(stage, len(members), count, amount, left, members[0].measure, hours))
    return found


def seconds_left(step: Step, count: Count, speed: float) -> float:
    """Return the core-seconds that a step still takes."""
    return step.seconds(speed) * (1.0 - count.share)


def _hours(step: Step, count: Count, speeds: Mapping[str, float] | None) -> float:
    if speeds is None:
        return float("nan")
    return seconds_left(step, count, speeds[step.task]) / 3600.0


def cost_text(found: Sequence[Line], cores: int) -> str:
    """Return remaining work and time as text."""
    rows = [
        f"  {line.stage:24} {line.left:>18,.0f} of {line.amount:,.0f} {line.measure} left, {_duration(line.hours)}"
        for line in found
    ]
    total = sum(line.hours for line in found)
    return "\n".join([*rows, f"  together {_duration(total)} on {cores} core{'s' if cores > 1 else ''}"])


def status_text(found: Sequence[Line]) -> str:
    """Return the counts of done, running and failed units as text."""
    rows = []
    for line in found:
        count = line.count
        states = [f"{count.done:,} of {count.total:,} units done"]
        states += [
            f"{number} {name}" for number, name in ((count.running, "running"), (count.failed, "failed")) if number
        ]
        rows.append(f"  {line.stage:24} {', '.join(states)} ({count.share:.0%} of the work)")
    return "\n".join(rows)


def failed_steps(steps: Sequence[Step], counts: Mapping[str, Count]) -> list[str]:
    """Return the keys of steps with failed units."""
    return [step.key for step in steps if counts[step.key].failed]


def _duration(hours: float) -> str:
    if hours != hours:
        return "time unknown"
    if hours < 1.0 / 60.0:
        return f"{3600.0 * hours:.0f} s"
    return f"{60.0 * hours:.0f} min" if hours < 2.0 else f"{hours:,.1f} h"
