"""Run a study: every unfinished step, in order."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from perdure.runs import Observer, OtherSourceWarning, RunError, State, Status, UnitProgress
from perdure.studies.errors import StudyError
from perdure.studies.status import read_step_progress
from perdure.studies.study import RunOptions, StepProgress, Study, StudyStep

SHORTEST_PAUSE, LONGEST_PAUSE = 1.0, 30.0
"""Seconds before steps that other commands are running are tried again."""


def run_steps(
    steps: Sequence[StudyStep],
    options: RunOptions,
    sizes: Mapping[str, float] | None = None,
    report: Callable[[str], None] = lambda line: None,
) -> None:
    """Finish every step. A step is skipped if its predecessors failed; the others continue.

    A step whose remaining units another command is running is put off, so several commands share the steps of a study.
    When all that are left have been put off, they are tried again and again.

    Args:
        steps: In their order.
        options: Where; its observer is called with the progress of the whole study.
        sizes: Work of each step beside others, by key, such as its seconds; the step's own amount by default.
        report: Called with a line when a step begins, is put off or fails.

    Raises:
        RunError: Steps failed; raised when all others are done.
    """
    board = _Board(steps, read_step_progress(steps), sizes, options.observe)
    failed: dict[str, str] = {}
    caught = _Caught()
    left, told, pause = list(steps), False, SHORTEST_PAUSE
    while left:
        put_off: dict[str, StudyStep] = {}
        for step in left:
            if any(key in failed for key in step.after):
                failed[step.key] = "a step it depends on failed"
                board.set(step.key, "blocked")
                continue
            if any(key in put_off for key in step.after):
                put_off[step.key] = step
                continue
            here = replace(options, observe=board.observer(step.key), waiting=_put_off)
            with caught.of(step.key):
                state, error = _attempt(step, here, report)
            board.set(step.key, state)
            if state == "busy":
                put_off[step.key] = step
            elif state == "failed":
                failed[step.key] = error
        if len(put_off) < len(left):
            pause = SHORTEST_PAUSE
        else:
            if not told:
                told = True
                options.waiting()
            time.sleep(pause)
            pause = min(2.0 * pause, LONGEST_PAUSE)
        left = list(put_off.values())
    caught.show()
    if failed:
        first = next(iter(failed))
        raise RunError(f"{len(failed)} of {len(steps)} steps failed: {first}: {failed[first]}")


def _attempt(step: StudyStep, options: RunOptions, report: Callable[[str], None]) -> tuple[State, str]:
    """Run a step; return what became of it, and the error if it failed."""
    report(step.key)
    try:
        step.run(options)
    except _PutOffError:
        report(f"{step.key} put off: another command is running its remaining units")
        return "busy", ""
    except ValueError as error:
        if not type(error).__module__.startswith("perdure."):  # a fault of the program
            raise
        report(f"{step.key} failed: {error}")
        return "failed", str(error)
    return "finished", ""


class _PutOffError(Exception):
    """Another command is running the step, or its remaining units."""


def _put_off() -> None:
    raise _PutOffError


class _Caught:
    """Warnings of all steps, however often a step is tried."""

    def __init__(self) -> None:
        self._others: dict[tuple[type[Warning], str], Warning | str] = {}
        self._reused: set[str] = set()

    @contextmanager
    def of(self, key: str) -> Iterator[None]:
        """Catch the warnings of a step."""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", OtherSourceWarning)
            yield
        for each in caught:
            if issubclass(each.category, OtherSourceWarning):
                self._reused.add(key)
            else:
                self._others[each.category, str(each.message)] = each.message

    def show(self) -> None:
        """Show each of them once; those about other source versions are merged into one."""
        for (category, _), message in self._others.items():
            warnings.warn(message, category, stacklevel=3)
        if self._reused:
            warnings.warn(
                f"results of {len(self._reused)} steps were made by another version of perdure's source code and are "
                "reused. Remove a result's folder to compute it again.",
                OtherSourceWarning,
                stacklevel=3,
            )


class _Board:
    """The progress of all steps as one status: the running step by its units, the others as one unit each."""

    def __init__(
        self,
        steps: Sequence[StudyStep],
        progress: Mapping[str, StepProgress],
        sizes: Mapping[str, float] | None,
        observe: Observer,
    ) -> None:
        self._observe = observe
        self._all: dict[str, UnitProgress] = {}
        for step in steps:
            state, size = progress[step.key], step.amount if sizes is None else sizes[step.key]
            finished = state.done >= state.total
            self._all[step.key] = UnitProgress("finished" if finished else "waiting", state.share, 1.0, {}, "", size)

    def set(self, key: str, state: State) -> None:
        """Record the state of a step."""
        self._all[key] = replace(self._all[key], state=state)
        self._observe(self._all)

    def observer(self, key: str) -> Observer:
        """Return an observer of one step's units."""

        def observe(status: Status) -> None:
            whole = sum(each.size for each in status.values()) or 1.0
            scale = self._all[key].size / whole
            share = sum(each.size * each.share for each in status.values()) / whole
            self._all[key] = replace(self._all[key], done=share)
            units = {f"{key}/{unit}": replace(each, size=each.size * scale) for unit, each in status.items()}
            self._observe({**{other: each for other, each in self._all.items() if other != key}, **units})

        return observe


def check_results(study: Study, path: Path) -> None:
    """Raise StudyError for a folder without results of a study."""
    if not any((path / name).is_dir() for name in study.holds):
        raise StudyError(
            f"there are no results of the study {study.name} in {path}; run it first, or name another folder with --out"
        )


def check_page(study: Study, path: Path) -> None:
    """Raise StudyError for a folder whose README is not a page of the study; the analysis would overwrite it."""
    page = path / "README.md"
    if page.is_file() and study.mark not in page.read_text(errors="replace"):
        raise StudyError(f"{page} is not a page of the study {study.name}; move it, or name another folder with --out")
