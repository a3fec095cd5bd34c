"""A study: a question, scales, resumable steps and an analysis of their results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from typing import Protocol

from perdure.runs import Observer
from perdure.studies.errors import StudyError

_STUDIES = {"horizon": "perdure.studies.horizon.study", "placement": "perdure.studies.placement.study"}
"""Name to the module that defines it as STUDY."""


@dataclass(frozen=True)
class StepProgress:
    """Progress of a step, in units of work."""

    total: int
    done: int
    running: int = 0
    """Units that a process is running now."""
    failed: int = 0
    """Units whose last attempt ended with an error."""
    share: float = 0.0
    """Share of the step's work that is done, unfinished units included; from 0 to 1."""


@dataclass(frozen=True)
class RunOptions:
    """Where a step runs, and callbacks for its progress. No result depends on it."""

    on: str = "local"
    """See `perdure.runs.make_workers`."""
    cores: int | None = None
    observe: Observer = lambda status: None
    waiting: Callable[[], None] = lambda: None
    """Called once, before waiting for another command that runs the same step, or its remaining units."""


class StudyStep(Protocol):
    """A resumable part of a study; a finished step is not run again."""

    @property
    def key(self) -> str:
        """Readable identity, such as "training Hopper-v3/geometric@cleanrl"."""

    @property
    def stage(self) -> str:
        """What kind of work it is, such as "training"; steps of one stage are counted together."""

    @property
    def after(self) -> tuple[str, ...]:
        """Keys of steps that must be finished first."""

    @property
    def task(self) -> str:
        """Name of the task that is stepped, for `make_world`; "" if no speed is measured."""

    @property
    def amount(self) -> float:
        """Total work, in the stage's measure."""

    @property
    def measure(self) -> str:
        """What `amount` counts, such as "training steps"."""

    def seconds(self, speed: float) -> float:
        """Return the core-seconds of the whole step where one core makes `speed` lane steps of the task a second."""

    def progress(self) -> StepProgress:
        """Return its progress, read from the store."""

    def run(self, options: RunOptions) -> None:
        """Run it to its end.

        Raises:
            RunError: A unit failed.
        """


@dataclass(frozen=True)
class Scale:
    """Size of a study: rows, seeds and steps."""

    name: str
    about: str
    """In a sentence: rows, seeds, steps, and how long it takes."""
    folder: Path | None = None
    """Folder of its results in a clone of the repository, if they are kept there."""


@dataclass(frozen=True)
class Study:
    """A question with its scales, steps and analysis."""

    name: str
    question: str
    scales: tuple[Scale, ...]
    phases: tuple[int, ...]
    """Phases that run by default."""
    holds: tuple[str, ...]
    """Folders of which a folder with results has at least one."""
    mark: str
    """Text that every page of the study contains."""
    plan: Callable[[str, Path, Sequence[int]], Sequence[StudyStep]]
    """From (scale, folder of the results, phases) to all steps, in their order."""
    analyze: Callable[[str, Path], Sequence[Path]]
    """From (scale, folder) to the files written; reads what steps of any phase left, simulates nothing."""

    def folder(self, scale: str) -> Path:
        """Return the folder of a scale's results, where the user names no other.

        Raises:
            StudyError: There is no scale of that name.
        """
        names = [each.name for each in self.scales]
        if scale not in names:
            near = get_close_matches(scale, names, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise StudyError(f"study {self.name} has no scale {scale!r}; its scales are {', '.join(names)}{hint}")
        return self.scales[names.index(scale)].folder or Path("runs", f"{self.name}-{scale}")


def list_studies() -> tuple[str, ...]:
    """Return the names of all studies."""
    return tuple(_STUDIES)


def find_study(name: str) -> Study:
    """Return the study of that name.

    Raises:
        StudyError: There is none.
    """
    if name not in _STUDIES:
        near = get_close_matches(name, _STUDIES, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise StudyError(f"there is no study {name!r}; the studies are {', '.join(_STUDIES)}{hint}")
    study = import_module(_STUDIES[name]).STUDY
    assert isinstance(study, Study)
    return study
