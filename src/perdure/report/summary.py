"""The summary of a table for machines: one JSON document, its JSON Schema, JUnit XML, and a badge.

`Summary` declares the document; the schema is made from it (`docs/reference/verdict.schema.json`), and what the names
mean is in docs/reference/json.md.
"""

from __future__ import annotations

import json
import math
import platform
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Self
from xml.etree import ElementTree

import msgspec
import numpy as np

from perdure.report.caveats import CALM_WORK, listed
from perdure.report.estimates import HOLDING_SHARE, Estimate, Estimates, Verdict
from perdure.report.groups import Group, medians
from perdure.report.outcomes import CannotTell
from perdure.report.schema import EarlyStop, early_stop
from perdure.report.scores import HOLDS_FROM, IDLE_BELOW, holds_from
from perdure.runs import versions, write_atomic
from perdure.schema import Record
from perdure.stats import Interval

SCHEMA_VERSION = 1
"""Of `Summary`. It rises when a name goes or changes its meaning; new names may be added."""
SUMMARY = "verdict.json"
JUNIT = "junit.xml"
BADGE = "badge.json"
LIBRARIES = ("envpool", "gymnasium", "mujoco", "numpy")
"""Whose versions decide the result."""


class EstimateSummary(Record, frozen=True):
    """An estimate with its interval; None where it is unknown."""

    estimate: float | None
    low: float | None
    high: float | None

    @classmethod
    def of(cls, interval: Interval) -> Self:
        """Return the interval of the last recorded step."""
        return cls(*(_last(each) for each in (interval.estimate, interval.lower, interval.upper)))


class Thresholds(Record, frozen=True):
    """The numbers that decide."""

    share_that_holds: float
    score_that_holds: float
    idle_below: float
    calm_work: float


class TrainingRun(Record, frozen=True):
    """What the episodes of a training run are compared with. The first names are columns of the table."""

    policy: str
    train_seed: int
    policy_state: str
    policy_note: str
    training_falls: float | None
    idle_rate: float | None
    idle_steps: float | None
    training_rate: float | None
    way_rate: float | None
    published_rate: float | None
    calm_rate: float | None
    window: int
    settling: int
    training_low_share: float | None
    score_that_holds: float
    low_share: float | None


class GroupSummary(Record, frozen=True):
    """One policy (its training seeds together) under one clock and disturbance."""

    task: str
    policy: str
    clock: str
    disturbance: str
    not_applied: str
    episodes: int
    steps: int
    verdict: str
    clean: bool
    reasons: dict[str, str]
    outcomes: dict[str, int]
    share_that_holds: EstimateSummary
    mean_return: EstimateSummary
    end_score_vs_training: EstimateSummary
    work_vs_calm: EstimateSummary
    work_vs_published: EstimateSummary
    median_failure_step: float | None
    failures_per_hour: EstimateSummary | None
    measures: dict[str, float]
    training_runs: list[TrainingRun]


class Summary(Record, frozen=True):
    """What `perdure extrapolate --json` prints."""

    schema_version: int
    holds: bool
    clean: bool
    stopped_early: EarlyStop | None
    bounds: Thresholds
    groups: list[GroupSummary]
    table: str
    page: str
    versions: dict[str, str]

    @classmethod
    def of(cls, estimates: Estimates, table: Path, page: Path, notes: Mapping[str, str]) -> Self:
        """Return the summary of a table, with its notes, and its report."""
        return cls(
            schema_version=SCHEMA_VERSION,
            holds=not not_holding(estimates),
            clean=not not_clean(estimates),
            stopped_early=early_stop(notes),
            bounds=Thresholds(HOLDING_SHARE, HOLDS_FROM, IDLE_BELOW, CALM_WORK),
            groups=[_group(item) for items in estimates.values() for item in items],
            table=str(table.resolve()),
            page=str(page.resolve()),
            versions={"python": platform.python_version(), **versions(*LIBRARIES)},
        )

    def to_json(self) -> str:
        """Return the document."""
        return json.dumps(msgspec.to_builtins(self), indent=2, allow_nan=False)


def json_schema() -> str:
    """Return the JSON Schema of the document."""
    return json.dumps(msgspec.json.schema(Summary), indent=2) + "\n"


def not_holding(estimates: Estimates) -> list[str]:
    """Return who does not hold, such as "ppo: falls in 4 of 10 episodes", or why it cannot tell."""
    return [_short(verdict) for verdict in _verdicts(estimates) if not verdict.good]


def not_clean(estimates: Estimates) -> list[str]:
    """Return who does not hold, as `not_holding`, and who holds with caveats: "ppo: holds ..., but is interrupted"."""
    held = [verdict for verdict in _verdicts(estimates) if verdict.good and verdict.caveats]
    return [*not_holding(estimates), *(_with_caveats(verdict) for verdict in held)]


REQUIREMENTS: Mapping[str, Callable[[Estimates], list[str]]] = {"holds": not_holding, "clean": not_clean}
"""What `--require` names, to the function that returns who misses it."""


def write_summary(estimates: Estimates, table: Path, page: Path, notes: Mapping[str, str]) -> Summary:
    """Write the document, JUnit XML and a badge beside a report; return the document.

    Args:
        estimates: Of the table.
        table: The table's file.
        page: The report's page.
        notes: Of the table.
    """
    summary = Summary.of(estimates, table, page, notes)
    write_atomic(page.parent / SUMMARY, summary.to_json() + "\n")
    write_atomic(page.parent / JUNIT, junit(estimates))
    write_atomic(page.parent / BADGE, badge(estimates))
    return summary


def junit(estimates: Estimates) -> str:
    """Return JUnit XML: a suite for each task, a case for each policy, clock and disturbance.

    A policy that does not hold is a failure. One that holds with caveats passes and says them (system-out).
    """
    suites = ElementTree.Element("testsuites", name="perdure")
    for task, items in estimates.items():
        failures = sum(not item.verdict.good for item in items)
        suite = ElementTree.SubElement(suites, "testsuite", name=task, tests=str(len(items)), failures=str(failures))
        for item in items:
            group = item.group
            name = f"{group.policies}, {group.clock}, {group.disturbance}"
            case = ElementTree.SubElement(suite, "testcase", classname=task, name=name)
            if not item.verdict.good:
                label = item.verdict.label
                failure = ElementTree.SubElement(case, "failure", type=label, message=_short(item.verdict))
                failure.text = item.verdict.evidence
            elif item.verdict.caveats:
                ElementTree.SubElement(case, "system-out").text = _with_caveats(item.verdict)
    ElementTree.indent(suites)
    return ElementTree.tostring(suites, encoding="unicode", xml_declaration=True) + "\n"


def badge(estimates: Estimates) -> str:
    """Return the JSON of a badge for shields.io (its "endpoint"): the first verdict that does not hold, or "holds"."""
    message = "holds"
    color = "brightgreen"
    bad = [verdict.label for verdict in _verdicts(estimates) if not verdict.good]
    if bad:
        message = Counter(bad).most_common(1)[0][0]
        color = "red"
    elif not_clean(estimates):
        message = "holds, but"
        color = "orange"
    return json.dumps({"schemaVersion": 1, "label": "perdure", "message": message, "color": color}) + "\n"


def _verdicts(estimates: Estimates) -> Iterator[Verdict]:
    for items in estimates.values():
        for item in items:
            yield item.verdict


def _short(verdict: Verdict) -> str:
    if verdict.label == CannotTell.name:
        return verdict.sentence.rstrip(".")
    return verdict.short


def _with_caveats(verdict: Verdict) -> str:
    return f"{verdict.short}{listed(list(verdict.caveats))}"


def _group(item: Estimate) -> GroupSummary:
    group = item.group
    rate = group.failure_rate
    hourly = None
    if rate is not None:
        hourly = EstimateSummary(*(_last(each) for each in (rate.per_hour, rate.lower, rate.upper)))
    return GroupSummary(
        task=group.task,
        policy=group.policies,
        clock=group.clock,
        disturbance=group.disturbance,
        not_applied=group["not_applied"][0],
        episodes=group.episodes,
        steps=group.test_horizon,
        verdict=item.verdict.label,
        clean=item.verdict.clean,
        reasons=dict(item.verdict.caveats),
        outcomes=dict(Counter(group.verdicts)),
        share_that_holds=EstimateSummary.of(item.verdict.share),
        mean_return=EstimateSummary.of(item.returns),
        end_score_vs_training=EstimateSummary.of(item.final_score),
        work_vs_calm=EstimateSummary.of(item.work_vs_calm),
        work_vs_published=EstimateSummary.of(item.work_vs_published),
        median_failure_step=_last(group.half_failed_by),
        failures_per_hour=hourly,
        measures=medians(group),
        training_runs=list(_training_runs(group)),
    )


_OF_RUN = TrainingRun.__struct_fields__[:-2]
"""Columns of the table that are equal in all episodes of a training run in a group."""


def _training_runs(group: Group) -> Iterator[TrainingRun]:
    """Yield what the episodes of each training run are compared with, and their mean share of low windows."""
    for _, part in group.facts.group_by("policy", "train_seed", maintain_order=True):
        found = part.select(_OF_RUN).row(0, named=True)
        way_score = math.nan
        if not math.isnan(found["way_rate"]):
            gain = found["training_rate"] - found["idle_rate"]
            way_score = (found["way_rate"] - found["idle_rate"]) / gain
        known = {name: _known(value) for name, value in found.items()}
        low_share = _last(part["low_share"].to_numpy().mean())
        yield TrainingRun(**known, score_that_holds=holds_from(way_score), low_share=low_share)


def _known(value: Any) -> Any:
    """Return a value of the table; None for a number that is unknown."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _last(value: float | Sequence[float] | np.ndarray[Any, Any]) -> float | None:
    """Return the last number of a value; None where it is unknown."""
    number = float(np.ravel(value)[-1])
    return number if math.isfinite(number) else None


if __name__ == "__main__":
    write_atomic(Path("docs", "reference", "verdict.schema.json"), json_schema())
