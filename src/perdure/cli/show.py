"""Texts of `list` and `inspect`: tasks, training methods, shipped policies, the contents of a policy file."""

from __future__ import annotations

import json
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

    lines, width = list[str](), shutil.get_terminal_size().columns
    for name, members in groupby(list_tasks(suite), key=lambda task: task.suite):
        names = [task.name for task in members]
        rows = [f"  {each}" for each in names]
        if suite is None:
            end = f" ... {len(names)}: perdure list tasks --suite {shlex.quote(name)}"
            cut: dict[str, Any] = {"max_lines": MOST_ROWS, "placeholder": end, "break_on_hyphens": False}
            rows = textwrap.wrap("  ".join(names), width, initial_indent="  ", subsequent_indent="  ", **cut)
        lines += [f"{name}:", *rows]
    return "\n".join(lines)


def methods() -> str:
    """Return the table of training methods."""
    from perdure.learn import presets as module

    table = "".join((module.__doc__ or "").partition("| method |")[1:])
    return "\n".join(line for line in table.splitlines() if line.startswith("|")).replace("``", "")


def policies() -> str:
    """Return the shipped policies, one a line, each with its training command and, if known, its outcome."""
    from perdure.policy import load_policy
    from perdure.policy.files import LABELS, shipped_policies

    rows = []
    for name, path in shipped_policies().items():
        label = f"  # {LABELS[name]}" if name in LABELS else ""
        rows.append(f"{name:36} {load_policy(path).provenance.get('command', '')}{label}")
    return "\n".join(rows)


def _within(subject: Policy) -> str:
    """Return what a policy does within its training horizon, in one line."""
    reference = subject.reference
    if reference is None:
        return "not measured"
    falls, episodes = int(reference.terminated.sum()), len(reference.lengths)
    return (
        f"mean return {reference.returns.mean():,.0f} in {episodes} episodes of at most {reference.horizon} steps, "
        f"{reference.rate:.3g} a step, {falls} ended by the task"
    )


def policy_text(subject: Policy) -> str:
    """Return the contents of a policy file as text."""
    weights = sum(array.size for array in subject.weights.values())
    protocol = subject.protocol
    phi = "none" if protocol.embedding is None else f"{protocol.embedding}"
    rows = {
        "task": f"{subject.task.name}, observations of {subject.task.observation_size}, "
        f"actions of {subject.task.action_size}",
        "network": f"{weights:,} weights, {subject.activation}",
        "time-to-go input": phi + (", normalized (replication)" if protocol.normalize_embedding else ""),
        "training horizon": f"{protocol.horizon}, its end counts as {protocol.end}",
        "gamma": f"{protocol.gamma:g} (reward normalizer {protocol.normalizer_gamma:g})",
        "clock": "none" if subject.clock is None else subject.clock.label,
        "within T": _within(subject),
    }
    lines = [f"{name:17} {value}" for name, value in rows.items()]
    provenance = {k: v for k, v in subject.provenance.items() if k != "config"}
    return "\n".join([*lines, "", json.dumps(provenance, indent=2)])
