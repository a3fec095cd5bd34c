"""Worker processes on this machine: they use reserved cores and end with this process."""

from __future__ import annotations

import json
import os
import re
import selectors
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Protocol, Self

from perdure.runs.cores import own_cores
from perdure.runs.errors import RunError
from perdure.runs.unit import AttemptResult, Unit, attempt
from perdure.schema import printable

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment of a process whose libraries multiply on one thread from their first import on."""
PLACES = ("here", "local", "ray")
"""Values of `on` in `make_workers`, beside ray:ADDRESS."""
PARENT_SECONDS = 0.5
"""How often a worker checks whether the process that started it still lives."""
# The parent's module search path, and not the current folder: a worker imports what its parent would.
_START = "import sys, json; sys.path[:] = json.loads(sys.argv[1]); from perdure.runs.workers import serve; serve()"


@dataclass(frozen=True)
class Ended:
    """A finished attempt at a unit."""

    key: str
    result: AttemptResult | None
    """None if it failed."""
    error: str = ""
    """Why, in one line."""


class Workers(Protocol):
    """Interface of worker processes. Used as a context manager; leaving it ends all of them."""

    @property
    def free(self) -> int:
        """Number of units that can be started now."""

    def start(self, root: Path, unit: Unit) -> None:
        """Begin an attempt at a unit of the store in `root`."""

    def wait(self, seconds: float) -> list[Ended]:
        """Return the attempts that have ended, waiting for the first one for at most so many seconds."""

    def __enter__(self) -> Self:
        """Return itself."""

    def __exit__(self, *exception: object) -> None:
        """End every process."""


def make_workers(on: str, units: Sequence[Unit], cores: int | None = None) -> Workers | None:
    """Return what runs units, for `run_units`.

    Results do not depend on where units run. The command line and `extrapolate` run them "local" by default. `train`
    and the functions of `perdure.home` run them "here" by default, because only this process knows environments that
    it has registered itself; other processes find those named "gymnasium:module:Env-v0".

    Args:
        on: "here" (this process, one unit after the other), "local" (a process for each core: faster, also for one
            unit), "ray" (a Ray of this command's own on this machine) or "ray:ADDRESS" (a cluster that runs, such as
            "ray:auto").
        units: What is to be run; there are no more processes than units.
        cores: Cores to use; all that this process may use by default. Ray uses those of its cluster.

    Raises:
        RunError: If `on` or `cores` is out of range, or Ray is not installed.
    """
    check_on(on)
    total = core_count(cores)
    wanted = max((unit.cores for unit in units), default=1)
    if on == "here":
        return None
    if on == "local":
        count = max(1, min(total, len(units)))
        return LocalWorkers(count, max(1, min(total // count, wanted)))
    from perdure.runs.on_ray import RayWorkers

    return RayWorkers(on.partition(":")[2] or None, min(wanted, total))


def check_on(on: str) -> None:
    """Refuse what names no place for `make_workers`.

    Raises:
        RunError: With the valid values, and the nearest one.
    """
    if on not in PLACES and not re.fullmatch("ray:.+", on):
        nearest = get_close_matches(on, PLACES, n=1)
        hint = f"; did you mean {nearest[0]!r}?" if nearest else ""
        raise RunError(f"on must be here, local, ray or ray:ADDRESS, got {on!r}{hint}")


def core_count(cores: int | None) -> int:
    """Return the number of cores to use: all that this process may use if None.

    Raises:
        RunError: If it is not at least 1.
    """
    if cores is not None and cores < 1:
        raise RunError(f"cores must be at least 1, got {cores}")
    return cores or len(os.sched_getaffinity(0))


class LocalWorkers:
    """Processes on this machine, each bound to idle cores if there are enough.

    They are started by a command line rather than by `multiprocessing`, so the caller's script is not imported again
    and needs no main guard.
    """

    def __init__(self, count: int, cores: int = 1) -> None:
        """Keep the settings; processes start with their units.

        Args:
            count: Processes, at least 1.
            cores: Cores of each.
        """
        if count < 1 or cores < 1:
            raise ValueError(f"count and cores must be at least 1, got {count} and {cores}")
        self._count, self._cores = count, cores
        self._stack = ExitStack()
        self._selector = selectors.DefaultSelector()
        self._idle: list[_Process] = []
        self._busy: dict[_Process, str] = {}
        self._places: list[Sequence[int]] = []

    @property
    def free(self) -> int:
        """See `Workers.free`."""
        return len(self._idle) + len(self._places)

    def __enter__(self) -> Self:
        """Choose the cores."""
        free = self._stack.enter_context(own_cores(self._count * self._cores))
        shares = [free[k * self._cores : (k + 1) * self._cores] for k in range(self._count)]
        self._places = [share if len(share) == self._cores else () for share in shares]
        return self

    def start(self, root: Path, unit: Unit) -> None:
        """See `Workers.start`."""
        process = self._idle.pop() if self._idle else _Process(self._places.pop(0), self._selector)
        self._busy[process] = unit.key
        process.send({"root": str(root), "unit": unit.to_json(), "threads": self._cores})

    def wait(self, seconds: float) -> list[Ended]:
        """See `Workers.wait`."""
        ended = []
        for selected, _ in self._selector.select(seconds):
            process: _Process = selected.data
            answer = process.receive()
            key = self._busy.pop(process, None)
            if key is None:  # it died while it had nothing to do
                self._idle.remove(process)
                self._places.append(process.cores)
                process.end()
            elif answer is None:
                self._places.append(process.cores)
                ended.append(Ended(key, None, process.end()))
            else:
                self._idle.append(process)
                ended.append(Ended(key, answer.get("result"), answer.get("error", "")))
        return ended

    def __exit__(self, *exception: object) -> None:
        """Kill every process: finished units and checkpoints are on disk."""
        processes = [*self._idle, *self._busy]
        for process in processes:
            process.kill()
        for process in processes:
            process.end()
        self._selector.close()
        self._stack.close()


class _Process:
    """One worker process."""

    def __init__(self, cores: Sequence[int], selector: selectors.BaseSelector) -> None:
        self.cores, self._selector = cores, selector
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - `end` closes it
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", _START, json.dumps(sys.path), json.dumps(list(cores)), str(os.getpid())],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            env={**os.environ, **ONE_THREAD},
        )
        assert self._process.stdout is not None
        selector.register(self._process.stdout, selectors.EVENT_READ, self)

    def send(self, job: Mapping[str, Any]) -> None:
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):  # it has ended: `receive` finds the end of its answers
            self._process.stdin.write(json.dumps(job).encode() + b"\n")
            self._process.stdin.flush()

    def receive(self) -> dict[str, Any] | None:
        """Return its answer, None if it has ended."""
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        return json.loads(line) if line.endswith(b"\n") else None

    def kill(self) -> None:
        self._process.kill()

    def end(self) -> str:
        """Release the resources of the process and return how it ended, in one line."""
        assert self._process.stdout is not None
        assert self._process.stdin is not None
        self._process.kill()
        code = self._process.wait()
        self._selector.unregister(self._process.stdout)
        self._process.stdout.close()
        with suppress(BrokenPipeError):  # a job that was never read
            self._process.stdin.close()
        self._errors.seek(0)
        lines = self._errors.read().decode(errors="replace").strip().splitlines()
        self._errors.close()
        if code < 0 and signal.Signals(-code) != signal.SIGKILL:
            return f"its process was ended by {signal.Signals(-code).name}"
        if code < 0:
            return "its process was ended by SIGKILL (out of memory?)"
        return lines[-1] if lines else f"its process ended with exit code {code}"


def serve() -> None:
    """Run a worker process: read one job per line from stdin, write one answer per line to stdout.

    What units print goes to standard error.
    """
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal's Ctrl-C reaches the parent too, which ends its workers
    if cores := json.loads(sys.argv[2]):
        os.sched_setaffinity(0, cores)
    # The parent is named by itself: it may have ended while this process was starting.
    threading.Thread(target=_end_with, args=(int(sys.argv[3]),), daemon=True).start()
    for line in sys.stdin:
        job = json.loads(line)
        answers.write(json.dumps(answer(job["root"], Unit.from_json(job["unit"]), job["threads"])) + "\n")
        answers.flush()


def answer(root: str, unit: Unit, threads: int) -> dict[str, str]:
    """Run a unit and return {"result": ...}, or {"error": ...} in one line if it fails."""
    try:
        return {"result": attempt(root, unit, threads)}
    except Exception as error:
        import traceback

        traceback.print_exc()
        return {"error": one_line(error)}


def one_line(error: BaseException) -> str:
    """Return an error as one line: the message alone for errors that perdure words, with its type for others."""
    text = printable(" ".join(str(error).split()))
    worded = type(error).__module__.startswith("perdure.")
    return text if worded and text else f"{type(error).__name__}: {text}" if text else type(error).__name__


def _end_with(parent: int) -> None:
    """End this process when its parent has ended. Files are written atomically, so none is left incomplete."""
    while os.getppid() == parent:
        time.sleep(PARENT_SECONDS)
    os._exit(1)
