"""Which policy acted in which skill, as far as the log files record it."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from perdure.home.errors import HomeError
from perdure.home.evaluate.log import EpisodeLog
from perdure.home.evaluate.outcomes import noted_hand_overs, noted_policies, read_logs, read_notes
from perdure.home.evaluate.outcomes.fields import POLICIES
from perdure.runs import Store, StoreError
from perdure.schema import SchemaError, printable

Group = tuple[str, str, str]
"""Task, split, strategy."""
ORACLE = "oracle"


@dataclass(frozen=True)
class PolicyAssignment:
    """The policy of each skill, and the commands that made the logs."""

    acting: Mapping[Group, Mapping[str, tuple[str, ...]]] = field(default_factory=dict)
    """For each task, split and strategy: skill to the names of its policies, one for each training seed."""
    commands: tuple[str, ...] = ()
    hand_overs: Mapping[Group, Mapping[str, int]] = field(default_factory=dict)
    """For each task, split and strategy: outcome of the hand-over to its count, see `HandOver.outcomes`."""

    def skills(self, task: str, split: str) -> list[str]:
        """Return the skills whose policies are recorded."""
        groups = [skills for group, skills in self.acting.items() if group[:2] == (task, split)]
        return list(dict.fromkeys(skill for skills in groups for skill in skills))


def read_assignment(paths: Sequence[str | os.PathLike[str]]) -> tuple[list[EpisodeLog], PolicyAssignment]:
    """Return the logs of files and their policies, from the notes or else from the store's record beside the file.

    Files of another simulator record no policies.

    Raises:
        HomeError: A file holds no logs, see `read_logs`, its note `policies` is no JSON object, or two files hold the
            same episode of a strategy and its seeds, such as those of a trial run and of the whole run.
    """
    records: list[EpisodeLog] = []
    acting: dict[Group, dict[str, dict[str, None]]] = {}
    commands: dict[str, None] = {}
    hand_overs: dict[Group, Counter[str]] = {}
    found: dict[tuple[object, ...], str | os.PathLike[str]] = {}
    for path in paths:
        read, notes = read_logs(path), read_notes(path)
        for record in read:
            if (other := found.setdefault(record.key, path)) != path:
                raise HomeError(f"{other} and {path} both hold {record.name}; leave one of the two files out")
        records += read
        commands |= {printable(notes["command"], lines=True): None} if notes.get("command") else {}
        policies = noted_policies(notes)
        policies = _beside(Path(path)) if policies is None else policies
        for group in {(record.task, record.split, record.strategy) for record in read}:
            if counts := noted_hand_overs(notes):
                hand_overs.setdefault(group, Counter()).update({printable(name): n for name, n in counts.items()})
            for skill, name in policies.items():
                acting.setdefault(group, {}).setdefault(printable(skill), {})[printable(name)] = None
    assignment = {group: {skill: tuple(names) for skill, names in skills.items()} for group, skills in acting.items()}
    return records, PolicyAssignment(assignment, tuple(commands), hand_overs)


def _beside(path: Path) -> dict[str, str]:
    """Return the policies in the store's record of a unit; nothing where there is none."""
    folder = path.resolve().parent
    try:
        policies = Store(folder.parent).config(folder.name).get("policies", {})
        POLICIES.check(policies)
    except (StoreError, SchemaError):
        return {}
    return {skill: ORACLE if name == ORACLE else f"learned, SHA-256 {name[:8]}" for skill, name in policies.items()}
