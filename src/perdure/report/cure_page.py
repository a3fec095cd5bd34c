"""A cure in words: one line of before and after, the page with both survival curves, and what to do next."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from perdure.report import wording
from perdure.report.charts import unique
from perdure.report.comparison import BETTER, CANNOT_TELL, WORSE, Summary
from perdure.report.comparison_page import headline as difference
from perdure.report.comparison_page import measures_table, summary_document
from perdure.report.estimates import Estimate
from perdure.report.figures import make_figures
from perdure.report.groups import NO_CLOCK, Group
from perdure.report.lead import DOCS, Step, verdict_row
from perdure.report.outcomes import Falls
from perdure.report.page import figures, header, page
from perdure.runs import write_atomic

PAGE = "cure.html"
"""Name of the page of a cure."""
CURED = "cured.safetensors"
"""Name of the cured policy in the folder of the results."""
HELD = "held already"
"""Verdict on a cure of a policy that needs none."""
NOTES = {
    BETTER: "The comparison shows that the cured policy is better.",
    WORSE: "The comparison shows that the further training made it worse: keep the policy you had.",
    CANNOT_TELL: "The comparison does not show that it helped: keep the policy you had.",
}
NOTE = (
    "Intervals are 95 %: of differences of the deciding condition by betting, of others Student's t below ten start "
    "states, else a bootstrap; a share is exact (Clopper-Pearson). Failures an hour are counted after settling; their "
    "bounds are one-sided 95 % each (Garwood)."
)
ANOTHER_NOISE = "standard-1"
"""What the next training may meet, if the first one did not help."""
MORE_STEPS = 1_000_000
"""Likewise."""


@dataclass(frozen=True)
class Cured:
    """What a cure did, for its page."""

    task: str
    before: Sequence[Estimate]
    """Of the policy that was trained further, one for each condition; the last one decides."""
    after: Sequence[Estimate] = ()
    """Of the cured policy, in the same order; () where nothing was trained."""
    summary: Summary | None = None
    """The comparison of both; None where nothing was trained."""
    selection: str = ""
    """How the cured policy was chosen among training seeds; "" if there was one."""

    @property
    def verdict(self) -> str:
        """`BETTER`, `WORSE` or `CANNOT_TELL`, of the cured policy; `HELD` where nothing was trained."""
        if self.summary is None:
            return HELD
        return self.summary.verdict

    @property
    def holds(self) -> bool:
        """Whether the policy holds under every condition, after the cure if there was one."""
        return all(item.verdict.good for item in self.after or self.before)


def headline(cured: Cured) -> str:
    """Return the answer: "Hopper-v3: a fall every 1.9 s -> none in 48 min, at 95 % of its speed"."""
    before = cured.before[-1].group
    if not cured.after:
        return f"{cured.task}: holds already, {failures(before)}: nothing to cure"
    after = cured.after[-1].group
    kept = _kept_speed(before, after)
    if cured.verdict == BETTER:
        return f"{cured.task}: {failures(before)} -> {failures(after, short=True)}{kept}"
    what = "the cure did not help"
    if cured.verdict == WORSE:
        what = "the cure made it worse"
    return f"{cured.task}: {what}: {failures(before)} before, {failures(after)} after{kept}"


def failures(group: Group, short: bool = False) -> str:
    """Return how often episodes fail: "a fall every 1.9 s", "no failure in 48 min", "none in 48 min" (short).

    Where the seconds of a step are unknown, or nothing disturbs the episodes: "3 of 36 episodes fail".
    """
    rate = group.failure_rate
    if rate is None:
        return f"{int(group.failed.sum())} of {wording.count(group.episodes, 'episode')} fail"
    if not rate.events:
        none = "no failure"
        if short:
            none = "none"
        return f"{none} in {wording.duration(rate.exposure_hours)}"
    noun = "failure"
    if {word for word, failed in zip(group.verdicts, group.failed, strict=True) if failed} == {Falls.name}:
        noun = "fall"
    return f"a {noun} every {wording.duration(rate.mean_hours)}"


def _kept_speed(before: Group, after: Group) -> str:
    """Return how much of its reward a step above idle the policy kept: ", at 95 % of its speed"; "" if unknown."""
    rates = [_gain(group) for group in (before, after)]
    if not (np.isfinite(rates).all() and rates[0] > 0.0):
        return ""
    return f", at {100.0 * rates[1] / rates[0]:.0f} % of its {_unit(before)}"


def _unit(group: Group) -> str:
    """Return what the reward a step above idle is called: that of a robot which is paid to move on is its speed."""
    if np.isfinite(group["published_rate"]).all():
        return "speed"
    return "reward"


def _gain(group: Group) -> float:
    """Return the reward a step when calm, above that of an idle robot."""
    return float(group["calm_rate"][0] - group["idle_rate"][0])


def text(cured: Cured) -> str:
    """Return the answer, the verdicts and the comparison for a terminal."""
    lines = [headline(cured)]
    for title, items in (("before", cured.before), ("after", cured.after)):
        lines += [f"  {title:7}  {item.verdict.sentence}" for item in items]
    if cured.summary is not None:
        lines.append(f"  compare  {difference(cured.summary)}")
    if cured.selection:
        lines.append(f"  chosen   {cured.selection}")
    return "\n".join(lines)


def _condition(cured: Cured) -> str:
    """Return under what the failures of the first line were counted, and what its speed is."""
    group = cured.before[-1].group
    where = "when calm"
    if not group.calm:
        where = f"under {group.condition}"
    counted = f"{wording.count(group.episodes, 'episode')} of {group.test_horizon:,} steps {where}"
    unit = _unit(group).capitalize()
    return f"Failures are counted in {counted}. {unit}: reward a step when calm, above that of an idle robot."


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}"


def document(cured: Cured) -> dict[str, Any]:
    """Return a cure as a document for JSON."""
    comparison = None
    if cured.summary is not None:
        comparison = summary_document(cured.summary)
    return {
        "task": cured.task,
        "headline": headline(cured),
        "verdict": cured.verdict,
        "holds": cured.holds,
        "selection": cured.selection,
        "comparison": comparison,
    }


def next_steps(cured: Cured, policy: str, given: Mapping[str, Any], steps: int, out: Path) -> list[Step]:
    """Return what to do next.

    Args:
        cured: What the cure did.
        policy: The name by which commands find the policy that was trained further.
        given: Flags with which it is read, such as the environment of a model.
        steps: Environment steps of the further training.
        out: Folder of the results.
    """
    if cured.verdict == HELD:
        return []
    link = f"{DOCS}when-a-policy-fails.md#cure-it"
    if cured.verdict != BETTER:
        longer = {**given, "steps": max(steps, MORE_STEPS), "out": f"{out}-longer"}
        other = {**given, "disturb": ANOTHER_NOISE, "out": f"{out}-{ANOTHER_NOISE}"}
        return [
            Step("Train under what it will meet.", link, _command("cure", policy, other)),
            Step("Train for more steps.", link, _command("cure", policy, longer)),
        ]
    cured_file = str(out / CURED)
    confirm = {"first-eval-seed": 1000, "out": f"{out}-confirmed"}
    return [
        Step("Confirm it on other start states.", link, _command("extrapolate", cured_file, confirm)),
        Step("Export it for a runtime.", f"{DOCS}export-onnx.md", export_command(cured, cured_file)),
    ]


def export_command(cured: Cured, policy: str) -> str:
    """Return the command that exports the cured policy, with the clock under which it was judged."""
    flags = {}
    if cured.after and cured.after[-1].group.clock_kind != NO_CLOCK:
        flags["clock"] = cured.after[-1].group.clock_flag
    return _command("export", policy, flags, "cured.onnx")


def _command(name: str, policy: str, flags: dict[str, Any], *others: str) -> str:
    words = ["perdure", name, policy, *others]
    for flag, value in flags.items():
        words.append(f"--{flag}")
        if value is not True:
            words.append(str(value))
    return shlex.join(words)


def write_page(cured: Cured, following: Sequence[Step], out: Path, command: str, made: str) -> Path:
    """Write the page of a cure into a folder; return its path.

    Args:
        cured: What the cure did.
        following: What to do next.
        out: The folder.
        command: What made it.
        made: What it was made with.
    """
    points = [_condition(cured)]
    if cured.summary is not None:
        points += [NOTES[cured.verdict], _sentence(difference(cured.summary)), *cured.summary.notes]
    if cured.selection:
        points.append(cured.selection)
    verdicts = []
    for title, items in (("before", cured.before), ("after", cured.after)):
        for item in items:
            row = verdict_row(item.verdict)
            verdicts.append(replace(row, who=f"{title}: {row.who}"))
    sentence = _sentence(headline(cured).removeprefix(f"{cured.task}: "))
    parts = [header(cured.task, sentence, points, verdicts, following)]
    top, _ = make_figures([*cured.before, *cured.after])
    parts.append(figures(unique(top, set())))
    if cured.summary is not None:
        parts.append(measures_table(cured.summary, NOTE))
    return write_atomic(out / PAGE, page(headline(cured), parts, command, made))
