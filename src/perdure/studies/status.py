"""Remaining time and progress of a study, read from its stores, also while another process runs it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from perdure.runs import Store, read_unit_progress
from perdure.studies.study import StepProgress, StudyStep


@dataclass(frozen=True)
class Line:
    """Summary of the steps of one stage."""

    stage: str
    steps: int
    progress: StepProgress
    amount: float
    """All the work."""
    left: float
    """The work that is left, in the same measure."""
    measure: str
    hours: float
    """Hours on the given cores for what is left; nan where no speed is known."""


def read_step_progress(steps: Sequence[StudyStep]) -> dict[str, StepProgress]:
    """Return how far each step is, by its key."""
    return {step.key: step.progress() for step in steps}


def count_units(
    folder: Path, sizes: Mapping[str, float], configs: Mapping[str, Mapping[str, Any]] | None = None
) -> StepProgress:
    """Return the progress of a step whose units are in one store.

    Args:
        folder: Of the store, which need not exist.
        sizes: Key of each unit to its amount of work.
        configs: Key to the config of units that must have it.

    Raises:
        StoreError: A finished unit has another config.
    """
    if not folder.is_dir():
        return StepProgress(len(sizes), 0)
    store, configs = Store(folder), configs or {}
    units = {key: read_unit_progress(store, key, configs.get(key), size) for key, size in sizes.items()}
    open_keys = [key for key, unit in units.items() if unit.state != "finished"]
    return StepProgress(
        total=len(units),
        done=len(units) - len(open_keys),
        running=sum(store.is_busy(key) for key in open_keys),
        failed=sum(store.note_path("failures", key).exists() for key in open_keys),
        share=sum(unit.size * unit.share for unit in units.values()) / sum(sizes.values()),
    )


def lines(
    steps: Sequence[StudyStep],
    progress: Mapping[str, StepProgress],
    speeds: Mapping[str, float] | None = None,
    cores: int = 1,
) -> list[Line]:
    """Return the stages in their order.

    Args:
        steps: Of the study.
        progress: From `read_step_progress`.
        speeds: Lane steps a second of one core for each task; None: hours are not known.
        cores: That work at the same time.
    """
    found = []
    for stage in dict.fromkeys(step.stage for step in steps):
        members = [step for step in steps if step.stage == stage]
        of = [progress[step.key] for step in members]
        total = sum(each.total for each in of)
        amount = sum(step.amount for step in members)
        left = sum(step.amount * (1.0 - each.share) for step, each in zip(members, of, strict=True))
        together = StepProgress(
            total,
            sum(each.done for each in of),
            sum(each.running for each in of),
            sum(each.failed for each in of),
            1.0 - left / amount if amount else 1.0,
        )
        hours = sum(_hours(step, progress[step.key], speeds) for step in members) / cores
        found.append(Line(stage, len(members), together, amount, left, members[0].measure, hours))
    return found


def seconds_left(step: StudyStep, progress: StepProgress, speed: float) -> float:
    """Return the core-seconds that a step still takes."""
    return step.seconds(speed) * (1.0 - progress.share)


def _hours(step: StudyStep, progress: StepProgress, speeds: Mapping[str, float] | None) -> float:
    if speeds is None:
        return float("nan")
    return seconds_left(step, progress, speeds[step.task]) / 3600.0


def cost_text(found: Sequence[Line], cores: int) -> str:
    """Return remaining work and time as text."""
    rows = [
        f"  {line.stage:24} {line.left:>18,.0f} of {line.amount:,.0f} {line.measure} left, {_duration(line.hours)}"
        for line in found
    ]
    total = sum(line.hours for line in found)
    return "\n".join([*rows, f"  together {_duration(total)} on {cores} core{'s' if cores > 1 else ''}"])


def status_text(found: Sequence[Line]) -> str:
    """Return the numbers of done, running and failed units as text."""
    rows = []
    for line in found:
        states = [f"{line.progress.done:,} of {line.progress.total:,} units done"]
        states += [
            f"{number} {name}"
            for number, name in ((line.progress.running, "running"), (line.progress.failed, "failed"))
            if number
        ]
        rows.append(f"  {line.stage:24} {', '.join(states)} ({line.progress.share:.0%} of the work)")
    return "\n".join(rows)


def failed_steps(steps: Sequence[StudyStep], progress: Mapping[str, StepProgress]) -> list[str]:
    """Return the keys of steps with failed units."""
    return [step.key for step in steps if progress[step.key].failed]


def _duration(hours: float) -> str:
    if hours != hours:
        return "time unknown"
    if hours < 1.0 / 60.0:
        return f"{3600.0 * hours:.0f} s"
    return f"{60.0 * hours:.0f} min" if hours < 2.0 else f"{hours:,.1f} h"
