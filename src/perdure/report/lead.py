"""The top of the page of a table: one line, each verdict with its details as chips, and what to do next."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from perdure.disturbances import CALM, applied_disturbances, labels
from perdure.report.caveats import listed
from perdure.report.estimates import Estimate, Verdict, advice
from perdure.report.groups import NO_CLOCK, Group
from perdure.report.outcomes import COLORS, CONFIRM, CURE, CannotTell, Color, NeverWorked, outcome
from perdure.report.schema import FILE_NOTE, IMPORTED

MOST_IN_HEADLINE = 2
"""Most policies and clocks that the headline names."""
MOST_NAMED = 3
"""Most policies for which it is said what to do next."""
DOCS = "https://github.com/perdure/perdure/blob/main/docs/how-to/"
CONFIRM_FROM = 1000
"""First start state of the evaluation that confirms this one, counted from its own first one."""


@dataclass(frozen=True)
class Chip:
    """A few words in a frame."""

    text: str
    color: Color | None = None
    """None: that of the page's text."""


@dataclass(frozen=True)
class VerdictRow:
    """A verdict as the top of a page shows it."""

    word: Chip
    who: str
    details: tuple[Chip, ...]


@dataclass(frozen=True)
class Step:
    """What to do next."""

    sentence: str
    link: str
    """Where it is described."""
    command: str = ""
    """A command that does it."""


def one_line(verdicts: Sequence[Verdict]) -> str:
    """Return the verdicts on a task's policies in a few words: "geometric holds; ppo falls when disturbed".

    More than `MOST_IN_HEADLINE` policies and clocks are counted.
    """
    if all({*verdict.group.verdicts} == {NeverWorked.name} for verdict in verdicts):
        return "No policy works, even within its training horizon"
    parts: dict[str, list[Verdict]] = {}
    for verdict in verdicts:
        parts.setdefault(verdict.group.policy_and_clock, []).append(verdict)
    if len(parts) > MOST_IN_HEADLINE:
        good = [mine for mine in parts.values() if all(verdict.good for verdict in mine)]
        clean = [mine for mine in good if all(verdict.clean for verdict in mine)]
        with_caveats = ""
        if len(clean) < len(good):
            number = f"{len(good) - len(clean)} of them" if clean else "all"
            with_caveats = f", {number} with caveats"
        return f"{len(good)} of {len(parts)} policies and clocks hold{with_caveats}"
    short = len({mine[0].group.policies for mine in parts.values()}) == len(parts)
    return "; ".join(_clause(mine[0].group.policies if short else name, mine) for name, mine in parts.items())


def _clause(name: str, verdicts: Sequence[Verdict]) -> str:
    """Return the verdict on one policy and clock: the first bad one, when calm before disturbed."""
    ordered = sorted(verdicts, key=lambda verdict: not verdict.group.calm)
    bad = next((verdict for verdict in ordered if not verdict.good), None)
    if bad is None:
        caveats = [caveat for verdict in ordered for caveat in verdict.caveats]
        return f"{name} {ordered[0].label}{listed(caveats[:1])}"
    condition = ""
    if not bad.group.calm and ordered[0].group.calm:
        condition = " when disturbed"
    if bad.label == CannotTell.name:
        return f"cannot tell whether {name} holds{condition}"
    some = f" in {bad.count} of {bad.group.episodes} episodes" if bad.count < bad.group.episodes else ""
    return f"{name} {bad.label}{some}{condition}"


def verdict_row(verdict: Verdict) -> VerdictRow:
    """Return a verdict with its details, caveats first in the color of what is undecided."""
    amber = COLORS[None]
    word = Chip(verdict.word, outcome(verdict.label).page_color)
    if verdict.caveats:
        word = Chip(verdict.word, amber)
    claim, *parts = verdict.details
    details = [Chip(claim)]
    for name, reason in verdict.caveats.items():
        details.append(Chip(f"{name}: {reason}", amber))
    details += map(Chip, parts)
    return VerdictRow(word, verdict.group.label, tuple(details))


# What to do next


def next_steps(
    estimates: Sequence[Estimate],
    folder: Path,
    command: str,
    notes: Mapping[str, str] | None,
    files: Mapping[str, str],
) -> list[Step]:
    """Return what to do next, each sentence once, for the policies that are named first.

    Args:
        estimates: Of one task.
        folder: Of the table, where imported policies are.
        command: What made the table; "": unknown.
        notes: Metadata of the table's file; None: unknown.
        files: SHA-256 of policy files to the names by which commands find them.
    """
    parts: dict[str, list[Verdict]] = {}
    for item in estimates:
        parts.setdefault(item.group.policy_and_clock, []).append(item.verdict)
    found: dict[tuple[str, str], list[Verdict]] = {}
    for verdicts in parts.values():
        found.setdefault(advice(verdicts), verdicts)
    # A function can neither be filmed nor trained further by a command: only tables of files name them.
    of_files = notes is None or any(name.startswith(FILE_NOTE) for name in notes)
    steps = []
    for (sentence, link), verdicts in list(found.items())[:MOST_NAMED]:
        does_it = ""
        failing = [verdict.group for verdict in verdicts if verdict.group.failed.any()]
        if sentence == CONFIRM.sentence:
            does_it = confirming(command)
        elif sentence == CURE.sentence and of_files and failing:
            name = _name(failing[0], folder, notes or {}, files)
            does_it = " ".join(["perdure cure", name, *_flags(_reading(failing[0], folder, command))])
        steps.append(Step(sentence, link, does_it))
    failed = [item.group for item in estimates if item.group.failed.any()]
    if of_files and failed:
        name = _name(failed[0], folder, notes or {}, files)
        watch = _watch_command(failed[0], folder, command, name)
        steps.append(Step("See the first failure (needs perdure[film]).", f"{DOCS}watch-a-failure.md", watch))
    return steps


def _name(group: Group, folder: Path, notes: Mapping[str, str], files: Mapping[str, str]) -> str:
    """Return the word by which commands find the policy of the first failed episode of a group; else POLICY."""
    seed = group["train_seed"][group.failed][0]
    policy = group["policy"][group.failed][0]
    name = files.get(notes.get(f"{FILE_NOTE}{policy}, training seed {seed}", ""), "")
    imported = list((folder / IMPORTED).glob("*.safetensors"))
    if name:
        return shlex.quote(name)
    if len(imported) == 1:
        return shlex.quote(str(imported[0]))
    return "POLICY"


def _reading(group: Group, folder: Path, command: str) -> dict[str, str | int]:
    """Return the flags with which a command reads a policy: the environment of a model, and the module of a task."""
    options: dict[str, str | int] = {}
    imported = any((folder / IMPORTED).glob("*.safetensors"))
    if ".onnx" in command and not imported:  # other files name their environment
        options["env"] = shlex.quote(group.task)
    module = group.task.rpartition(":")[0].partition(":")[2]
    if module:
        options["modules"] = shlex.quote(module)
    return options


def _flags(options: Mapping[str, str | int]) -> list[str]:
    return [f"--{option} {value}" for option, value in options.items()]


def confirming(command: str) -> str:
    """Return the command that repeats an evaluation from other start states; "" for what is no such command."""
    try:
        words = shlex.split(command)
    except ValueError:
        return ""
    if words[:2] != ["perdure", "extrapolate"]:
        return ""
    first = _take(words, "--first-eval-seed") or "0"
    out = _take(words, "--out") or "extrapolation"
    if not first.isdecimal():
        return ""
    words += ["--first-eval-seed", str(int(first) + CONFIRM_FROM), "--out", f"{out}-confirmed"]
    return shlex.join(words)


def _take(words: list[str], flag: str) -> str:
    """Remove a flag with its value from a command line, and return the value; "" where it is not there."""
    for place, word in enumerate(words):
        if word == flag and place + 1 < len(words):
            value = words[place + 1]
            del words[place : place + 2]
            return value
        if word.startswith(f"{flag}="):
            del words[place]
            return word.partition("=")[2]
    return ""


def _watch_command(group: Group, folder: Path, command: str, name: str) -> str:
    """Return the command that films the first failed episode of a group.

    Args:
        group: Episodes, of which some failed.
        folder: Of the table, where imported policies are.
        command: What made the table.
        name: Of the policy, as `_name` returns it.
    """
    options = _reading(group, folder, command)
    options["steps"] = group.test_horizon
    first = int(group["eval_seed"][group.failed].min())
    if first > 0:
        options["first-eval-seed"] = first
    if group.clock_kind != NO_CLOCK:
        options["clock"] = group.clock_flag
    left_out = group["not_applied"][0]
    disturb = group.disturbance
    if left_out and disturb != CALM:
        disturb = labels(applied_disturbances(disturb, left_out))
    options["disturb"] = disturb
    return " ".join(["perdure watch", name, "--until-failure", *_flags(options), "--out failure.mp4"])
