"""Texts of `list` and `inspect`: tasks, training methods, shipped policies, the contents of a policy file."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import textwrap
from itertools import groupby
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from perdure.policy import Policy

MOST_ROWS = 9
"""Rows of a suite that `perdure list tasks` shows."""


def tasks(suite: str | None = None) -> str:
    """Return the tasks of one suite, one a line; for None the first tasks of every suite."""
    from perdure.envs import list_tasks

    lines: list[str] = []
    width = shutil.get_terminal_size().columns
    for name, members in groupby(list_tasks(suite), key=lambda task: task.suite):
        names = [task.name for task in members]
        rows = [f"  {each}" for each in names]
        if suite is None:
            end = f" ... {len(names)}: perdure list tasks --suite {shlex.quote(name)}"
            width = max(width, len(end) + 1)
            cut: dict[str, Any] = {"max_lines": MOST_ROWS, "placeholder": end, "break_on_hyphens": False}
            rows = textwrap.wrap("  ".join(names), width, initial_indent="  ", subsequent_indent="  ", **cut)
        lines += [f"{name}:", *rows]
    return "\n".join(lines)


def methods() -> str:
    """Return the table of training methods."""
    from perdure.learn import METHODS
    from perdure.learn import presets as module
    from perdure.learn.algorithm import all_methods

    table = "".join((module.__doc__ or "").partition("| method |")[1:])
    lines = [line.replace("``", "") for line in table.splitlines() if line.startswith("|")]
    for name, kind in all_methods().items():
        if name not in METHODS:
            lines.append(f"{name}: {(kind.__doc__ or '').partition(chr(10))[0]}")
    return "\n".join(lines)


def policies() -> str:
    """Return the shipped policies, one a line, each with its training command and, if known, its outcome."""
    from perdure.policy import load_policy
    from perdure.policy.files import LABELS, shipped_policies

    rows = []
    for name, path in shipped_policies().items():
        row = f"{name:36} {load_policy(path).provenance.get('command', '')}"
        if name in LABELS:
            row += f"  # {LABELS[name]}"
        rows.append(row)
    return "\n".join(rows)


def disturbances() -> str:
    """Return the kinds of disturbances, one a line: an example, what it does, and who disturbs robots in this way."""
    from perdure.disturbances import Effect

    rows = []
    for name, kind in Effect.kinds().items():
        row = f"{f'{name}:{kind.example:g}':23} {kind.words}"
        if kind.source:
            row += f" ({kind.source})"
        rows.append(row)
    return "\n".join(rows)


def observations() -> str:
    """Return the observation terms that contracts of robots may name, one a line, with their other names."""
    from perdure.robots.terms import ObservationTerm

    rows = []
    for name, kind in ObservationTerm.kinds().items():
        row = f"{name:20} {kind.words}"
        if kind.aliases:
            row += f" (also {', '.join(kind.aliases)})"
        rows.append(row)
    return "\n".join(rows)


def _within(subject: Policy) -> str:
    """Return what a policy does within its training horizon, in one line."""
    reference = subject.reference
    if reference is None:
        return "not measured"
    falls = int(reference.terminated.sum())
    return (
        f"mean return {reference.returns.mean():,.0f} in {len(reference.lengths)} episodes of at most "
        f"{reference.horizon} steps, "
        f"{reference.rate:.3g} a step, {falls} ended by the task"
    )


def policy_text(subject: Policy) -> str:
    """Return the contents of a policy file as text."""
    weights = sum(array.size for array in subject.weights.values())
    protocol = subject.protocol
    phi = "none"
    if protocol.embedding is not None:
        phi = f"{protocol.embedding}"
    if protocol.normalize_embedding:
        phi += ", normalized (replication)"
    rows = {
        "task": f"{subject.task.name}, observations of {subject.task.observation_size}, "
        f"actions of {subject.task.action_size}",
        "network": f"{weights:,} weights, {subject.activation}",
        "time-to-go input": phi,
        "training horizon": f"{protocol.horizon}, its end counts as {protocol.end}",
        "gamma": f"{protocol.gamma:g} (reward normalizer {protocol.normalizer_gamma:g})",
        "clock": "none" if subject.clock is None else subject.clock.label,
        "within T": _within(subject),
    }
    lines = [f"{name:17} {value}" for name, value in rows.items()]
    provenance = {k: v for k, v in subject.provenance.items() if k not in ("config", "stages")}
    return "\n".join([*lines, "", json.dumps(provenance, indent=2)])


TABLES = {
    "joint_names": r"joint_|default_joint_pos|action_scale",
    "dof_names": r"dof_names|kp|kd",
    "observation_names": r"observation_",
}
"""Names in the metadata of ONNX models (mjlab, holosoma), and what is shown beside them, if there is one of each."""
ROUNDED = r"(-?\d+\.\d{3}[,;]?)+"
"""Numbers as mjlab writes them."""


def model_text(path: str) -> str:
    """Return the contents of an ONNX model as text: inputs, outputs, metadata; or why it is not read."""
    from perdure.errors import PerdureError
    from perdure.policy.onnx import OnnxModel, metadata
    from perdure.schema import printable

    notes = {printable(name): printable(value) for name, value in metadata(path).items()}
    try:
        rows = OnnxModel.load(path).signature
    except PerdureError as error:
        rows = {"not read": str(error)}
    rounded = ", ".join(name for name, value in notes.items() if re.fullmatch(ROUNDED, value))
    if rounded:
        rows["warning"] = f"perhaps rounded to three decimals: {rounded}"
    lines: list[str] = []
    for names, beside in TABLES.items():
        columns = {each: re.findall(r"[^\s,\"\[\]]+", notes[each]) for each in notes if re.match(beside, each)}
        columns = {each: cells for each, cells in columns.items() if len(cells) == len(columns.get(names, ()))}
        table = [(each, *columns[each]) for each in sorted(columns, key=lambda each: each != names)]
        widths = [max(map(len, column)) for column in table]
        lines += ["  ".join(map(str.ljust, row, widths)).rstrip() for row in zip(*table, strict=True)]
        if table:
            lines.append("")
        notes = {name: value for name, value in notes.items() if name not in columns}
    rows |= {name: textwrap.shorten(value, 200) for name, value in notes.items()}
    return "\n".join([*(f"{name:17} {value}" for name, value in rows.items()), "", *lines]).rstrip()
