"""Show the progress of a run: a bar in a terminal, a line every half minute elsewhere."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

from perdure.errors import call_pages, noted_call
from perdure.runs.run import Observer, Status, UnitProgress

LINE_SECONDS = 30.0
"""Seconds between lines if there is no terminal."""
HANG_SECONDS = 30.0
"""Seconds after which a call of third-party code is named."""


@contextmanager
def show_progress(title: str, measure: str = "") -> Iterator[Observer]:
    """Yield an observer for `run_missing` that shows a run on standard error for the duration of a block.

    Args:
        title: What runs.
        measure: What units count as done, such as "steps", to show how many a second; not shown by default.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    _watch_calls()
    console = Console(stderr=True)
    if not console.is_terminal:
        lines = Lines(title, measure)
        yield lines
        lines.close()
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[words]}"))
    bar = Progress(*columns, console=console)
    pace = _Pace(measure)
    task = bar.add_task(title, total=1.0, words="")

    def draw(status: Status) -> None:
        bar.start()  # at the first report: an error before it leaves no bar
        pace.note(status)
        bar.update(task, completed=total_share(status), words=_words(status, pace))

    try:
        yield draw
    finally:
        bar.stop()


@cache
def _watch_calls() -> None:
    """Start a thread that names, every HANG_SECONDS, each call of third-party code that has lasted so long."""

    def look() -> None:
        before: set[str] = set()
        while True:
            time.sleep(HANG_SECONDS)
            now = set(map(noted_call, call_pages)) - {""}
            for words in sorted(each.partition(" ")[2] for each in before & now):
                shown = f"still in {words}, for more than {HANG_SECONDS:g} s"
                print(f"{time.strftime('%H:%M:%S')}  {shown}", file=sys.stderr, flush=True)
            before = now

    threading.Thread(target=look, daemon=True).start()


class Lines:
    """Prints a line now and then, the first one after LINE_SECONDS: short runs stay silent. See `show_progress`."""

    def __init__(self, title: str, measure: str) -> None:
        _watch_calls()
        self._title = title
        self._pace = _Pace(measure)
        self._began = self._printed = time.monotonic()
        self._status: Status = {}

    def __call__(self, status: Status) -> None:
        """See `Observer`."""
        self._status = status
        self._pace.note(status)
        if time.monotonic() - self._printed >= LINE_SECONDS:
            self._print()

    def close(self) -> None:
        """Print the final state if any line was printed before."""
        if self._printed > self._began:
            self._print()

    def _print(self) -> None:
        self._printed = time.monotonic()
        words = _words(self._status, self._pace)
        print(f"{time.strftime('%H:%M:%S')}  {self._title}  {words}", file=sys.stderr, flush=True)


class _Pace:
    """Work since the first report: neither compilation counts nor what was resumed with it."""

    def __init__(self, measure: str) -> None:
        self._measure = measure
        self._before: dict[str, UnitProgress] = {}
        self._began = 0.0

    def note(self, status: Status) -> None:
        if not self._before:
            self._before = {key: each for key, each in status.items() if each.share}
            self._began = time.monotonic()

    def words(self, status: Status) -> tuple[str, str]:
        """Return the work per second and the time left; "" where they are not known."""
        elapsed = time.monotonic() - self._began
        pairs = [(each, self._before.get(key, UnitProgress("waiting"))) for key, each in status.items()]
        share = sum(each.size * (each.share - before.share) for each, before in pairs)
        left = sum(each.size * (1 - each.share) for each, _ in pairs)
        done = sum(each.done - before.done for each, before in pairs)
        rate = ""
        if self._measure and done > elapsed > 0:
            rate = f"{done / elapsed:,.0f} {self._measure}/s"
        remaining = ""
        if share > 0 and left:
            remaining = f"{_duration(elapsed * left / share)} left"
        return rate, remaining


def total_share(status: Status) -> float:
    """Return the share of all work that is done, from 0 to 1."""
    total = sum(each.size for each in status.values())
    if not total:
        return 1.0
    return sum(each.size * each.share for each in status.values()) / total


def count_states(status: Status) -> str:
    """Return the states of units in words, such as "3 of 10 done, 2 running, 1 failed"."""
    states: list[str] = [each.state for each in status.values()]
    names = {"running": "running", "busy": "run by another command", "failed": "failed"}
    others = [f"{states.count(state)} {name}" for state, name in names.items() if state in states]
    return ", ".join([f"{states.count('finished')} of {len(states)} done", *others])


def _words(status: Status, pace: _Pace) -> str:
    """Return the state in words. Facts whose name has a slash are for curves, not for this line."""
    facts: dict[str, list[float]] = {}
    for each in status.values():
        for name, value in each.facts.items():
            if math.isfinite(value) and "/" not in name:
                facts.setdefault(name.replace("_", " "), []).append(value)
    shown = [f"{name} {sum(values) / len(values):,.4g}" for name, values in facts.items()]
    parts = [f"{math.floor(100 * total_share(status))}%"]
    if len(status) > 1 or any(each.state == "busy" for each in status.values()):
        parts.append(count_states(status))
    rate, left = pace.words(status)
    parts += [rate, *shown, left]
    return "  ".join(filter(None, parts))


def _duration(seconds: float) -> str:
    hours, minutes = divmod(math.ceil(seconds / 60), 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min"
