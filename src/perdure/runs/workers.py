"""Worker processes on this machine, which use reserved cores and end with this process; tasks on a Ray cluster."""

from __future__ import annotations

import ctypes
import json
import mmap
import os
import pickle
import re
import selectors
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from perdure.errors import PAGE_BYTES, PerdureError, call_pages, did_you_mean, noted_call
from perdure.runs.files import acquire, release
from perdure.runs.store import AttemptResult, Unit, attempt
from perdure.schema import printable

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment of a process whose libraries multiply on one thread from their first import on."""
PLACES = ("here", "local", "ray")
"""Values of `on` in `make_workers`, beside ray:ADDRESS."""
# The parent's module search path, and not the current folder: a worker imports what its parent would.
_START = "import sys, json; sys.path[:] = json.loads(sys.argv[1]); from perdure.runs.workers import serve; serve()"
STAT = Path("/proc/stat")
USAGE_SECONDS = 0.2
"""Seconds for which core usage is measured."""
BUSY_SHARE = 0.5
"""A core that was busy for more than this share of that time is in use."""


def make_workers(on: str, units: Sequence[Unit], cores: int | None = None) -> Workers | None:
    """Return what runs units, for `run_missing`.

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
        PerdureError: If `on` or `cores` is out of range, or Ray is not installed.
    """
    check_on(on)
    total = core_count(cores)
    wanted = max((unit.cores for unit in units), default=1)
    if on == "here":
        return None
    if on == "local":
        count = max(1, min(total, len(units)))
        return LocalWorkers(count, max(1, min(total // count, wanted)))
    return RayWorkers(on.partition(":")[2] or None, min(wanted, total))


def check_on(on: str) -> None:
    """Refuse what names no place for `make_workers`.

    Raises:
        PerdureError: With the valid values, and the nearest one.
    """
    if on not in PLACES and not re.fullmatch("ray:.+", on):
        raise PerdureError(f"on must be here, local, ray or ray:ADDRESS, got {on!r}{did_you_mean(on, PLACES)}")


def core_count(cores: int | None) -> int:
    """Return the number of cores to use: all that this process may use if None.

    Raises:
        PerdureError: If it is not at least 1.
    """
    if cores is not None and cores < 1:
        raise PerdureError(f"cores must be at least 1, got {cores}")
    return cores or len(os.sched_getaffinity(0))


@dataclass(frozen=True)
class Ended:
    """A finished attempt at a unit."""

    key: str
    result: AttemptResult | None
    """None if it failed."""
    error: str = ""
    """Why, in one line."""


# Processes on this machine


class LocalWorkers:
    """`count` processes on this machine, each bound to `cores` idle cores if there are enough.

    They are started by a command line rather than by `multiprocessing`, so the caller's script is not imported again
    and needs no main guard.
    """

    def __init__(self, count: int, cores: int = 1) -> None:
        if count < 1 or cores < 1:
            raise ValueError(f"count and cores must be at least 1, got {count} and {cores}")
        self._count = count
        self._cores = cores
        self._stack = ExitStack()
        self._selector = selectors.DefaultSelector()
        self._idle: list[_Process] = []
        self._busy: dict[_Process, str] = {}
        self._places: list[Sequence[int]] = []

    @property
    def free(self) -> int:
        """Number of units that can be started now."""
        return len(self._idle) + len(self._places)

    def __enter__(self) -> Self:
        free = self._stack.enter_context(own_cores(self._count * self._cores))
        for k in range(self._count):
            share: Sequence[int] = free[k * self._cores : (k + 1) * self._cores]
            if len(share) < self._cores:
                share = ()  # too few idle cores: this process may run anywhere
            self._places.append(share)
        return self

    def start(self, root: Path, unit: Unit) -> None:
        """Begin an attempt at a unit of the store in `root`."""
        if self._idle:
            process = self._idle.pop()
        else:
            process = _Process(self._places.pop(0), self._selector)
        self._busy[process] = unit.key
        process.send(str(root), unit, self._cores)

    def wait(self, seconds: float) -> list[Ended]:
        """Return the attempts that have ended, waiting for the first one for at most so many seconds."""
        ended = []
        for selected, _ in self._selector.select(seconds):
            process: _Process = selected.data
            answer = process.receive()
            key = self._busy.pop(process, None)
            # A process that has died gives its cores back; one that has answered waits for the next unit.
            if key is None:  # it had nothing to do
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
        self.cores = cores
        self._selector = selector
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - `end` closes it
        self._page = tempfile.TemporaryFile()  # noqa: SIM115
        self._page.truncate(PAGE_BYTES)
        self._call = mmap.mmap(self._page.fileno(), PAGE_BYTES)
        call_pages.append(self._call)
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", _START, json.dumps(sys.path), json.dumps(list(cores)), str(os.getpid())],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            env={**os.environ, **ONE_THREAD},
            pass_fds=[self._page.fileno()],
        )
        assert self._process.stdout is not None
        selector.register(self._process.stdout, selectors.EVENT_READ, self)

    def send(self, root: str, unit: Unit, threads: int) -> None:
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):  # it has ended: `receive` finds the end of its answers
            self._process.stdin.write(pickle.dumps((self._page.fileno(), root, unit, threads)))
            self._process.stdin.flush()

    def receive(self) -> dict[str, Any] | None:
        """Return its answer, None if it has ended."""
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line.endswith(b"\n"):
            return None
        answer: dict[str, Any] = json.loads(line)
        return answer

    def kill(self) -> None:
        self._process.kill()

    def end(self) -> str:
        """Release the resources of the process and return how it ended, in one line."""
        assert self._process.stdout is not None
        assert self._process.stdin is not None
        try:
            code = self._process.wait(5.0)  # if it is killed while it ends, the cause is lost
        except subprocess.TimeoutExpired:
            self._process.kill()
            code = self._process.wait()
        call_pages.remove(self._call)
        self._page.close()
        _, _, words = noted_call(self._call).partition(" ")
        inside = words and f" in {words}"
        self._selector.unregister(self._process.stdout)
        self._process.stdout.close()
        with suppress(BrokenPipeError):  # a job that was never read
            self._process.stdin.close()
        self._errors.seek(0)
        lines = self._errors.read().decode(errors="replace").strip().splitlines()
        self._errors.close()
        if code < 0 and signal.Signals(-code) != signal.SIGKILL:
            return f"its process was ended by {signal.Signals(-code).name}{inside}"
        if code < 0:
            return f"its process was ended by SIGKILL{inside} (out of memory?)"
        if lines and not inside:
            return lines[-1]
        return f"its process ended with exit code {code}{inside}"


def serve() -> None:
    """Run a worker process: read the arguments of `answer` from stdin, write one answer per line to stdout.

    What units print goes to standard error, and they read from /dev/null: a unit that waits for input fails at once
    instead of reading the next argument.
    """
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    arguments = os.fdopen(os.dup(0), "rb")
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    # PR_SET_PDEATHSIG: the kernel ends this process with its parent. No file is left incomplete.
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)
    if os.getppid() != int(sys.argv[3]):  # the parent has ended while this process was starting
        os._exit(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal's Ctrl-C reaches the parent too, which ends its workers
    cores = json.loads(sys.argv[2])
    if cores:
        os.sched_setaffinity(0, cores)
    with suppress(EOFError):  # the parent has closed the pipe
        while True:
            page, *job = pickle.load(arguments)
            call_pages[0] = mmap.mmap(page, PAGE_BYTES)
            answers.write(json.dumps(answer(*job)) + "\n")
            answers.flush()


def answer(root: str, unit: Unit, threads: int) -> dict[str, str]:
    """Run a unit and return {"result": ...}, or {"error": ...} in one line if it fails."""
    try:
        return {"result": attempt(root, unit, threads)}
    except BaseException as error:  # SIGINT is ignored here: a KeyboardInterrupt is the unit's own
        import traceback

        traceback.print_exc()
        return {"error": one_line(error)}


def answer_on_node(root: str, unit: Unit, threads: int) -> dict[str, str]:
    """Do the same as `answer` in a task of Ray, bound to idle cores of its node as a worker of this machine is."""
    before = os.sched_getaffinity(0)
    with own_cores(threads) as cores:
        if len(cores) == threads:
            os.sched_setaffinity(0, cores)
        try:
            return answer(root, unit, threads)
        finally:
            os.sched_setaffinity(0, before)


def one_line(error: BaseException) -> str:
    """Return an error as one line: the message alone for errors that perdure words, with its type for others."""
    text = printable(" ".join(str(error).split()))
    kind = type(error).__name__
    if not text:
        return kind
    if isinstance(error, PerdureError):
        return text
    return f"{kind}: {text}"


# A Ray cluster


class RayWorkers:
    """Tasks on a Ray cluster, as many at once as it has cores for. Needs the extra ``perdure[ray]``.

    Every node must see the store's folder under the same path (a shared file system), with perdure installed. A task on
    a node that dies is started again on another one and resumes from the unit's checkpoint. `address` is that of a
    running cluster, such as "auto" or "host:6379"; None starts Ray on this machine.
    """

    def __init__(self, address: str | None = None, cores: int = 1) -> None:
        try:
            import ray
        except ImportError:
            raise PerdureError("running on Ray needs it installed: pip install 'perdure[ray]'") from None
        self._ray: Any = ray
        self._address = address
        self._cores = cores
        self._keys: dict[Any, str] = {}
        self._mine = False

    @property
    def free(self) -> int:
        """See `LocalWorkers.free`."""
        total = int(self._ray.cluster_resources().get("CPU", 1)) // self._cores
        return max(0, max(1, total) - len(self._keys))

    def __enter__(self) -> Self:
        if not self._ray.is_initialized():
            environment = {"env_vars": {**ONE_THREAD, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}}
            handler = signal.getsignal(signal.SIGTERM)
            self._ray.init(address=self._address, runtime_env=environment, log_to_driver=False, configure_logging=False)
            self._mine = True
            with suppress(ValueError, TypeError):  # Ray's own handler prints a C++ trace; not settable in other threads
                signal.signal(signal.SIGTERM, handler)
        # What the largest node has: a task that asks for more would never start.
        nodes = [int(node["Resources"].get("CPU", 0)) for node in self._ray.nodes() if node["Alive"]]
        self._cores = max(1, min(self._cores, max(nodes, default=1)))
        # Retries are for nodes that die, but Ray also counts a unit that ends its process. An error is an answer.
        self._task = self._ray.remote(num_cpus=self._cores, max_retries=3)(answer_on_node)
        return self

    def start(self, root: Path, unit: Unit) -> None:
        """See `LocalWorkers.start`."""
        self._keys[self._task.remote(str(root), unit, self._cores)] = unit.key

    def wait(self, seconds: float) -> list[Ended]:
        """See `LocalWorkers.wait`."""
        ready, _ = self._ray.wait(list(self._keys), num_returns=len(self._keys), timeout=seconds)
        ended = []
        for reference in ready:
            key = self._keys.pop(reference)
            try:
                found = self._ray.get(reference)
                ended.append(Ended(key, found.get("result"), found.get("error", "")))
            except self._ray.exceptions.RayError as error:
                ended.append(Ended(key, None, " ".join(str(error).split())[:500]))
        return ended

    def __exit__(self, *exception: object) -> None:
        for reference in self._keys:
            self._ray.cancel(reference, force=True)
        self._keys.clear()
        if self._mine:
            self._ray.shutdown()


Workers = LocalWorkers | RayWorkers
"""What runs units; used as a context manager, whose end ends all processes."""


# Idle cores


@contextmanager
def own_cores(count: int) -> Iterator[list[int]]:
    """Reserve at most ``count`` idle cores that no other perdure process has reserved, for the duration of a block.

    Otherwise two commands that start at the same time would choose the same cores. Workers are bound to cores because a
    loop that hands over to another thread at every step, as EnvPool's do, is much faster when both threads share one.
    """
    with ExitStack() as stack:
        taken: list[int] = []
        candidates = idle_cores() if count else []
        for core in candidates:
            if len(taken) == count:
                break
            lock = _lock(core)
            if lock is not None:
                stack.callback(release, lock)
                taken.append(core)
        yield taken


def idle_cores(counters: Path = STAT) -> list[int]:
    """Return idle cores that this process may run on, least busy first.

    Empty where the system does not say what its cores do.
    """
    try:
        before = _times(counters)
        time.sleep(USAGE_SECONDS)
        after = _times(counters)
        allowed = os.sched_getaffinity(0)
    except (OSError, ValueError, AttributeError):
        return []
    load = {}
    for core in allowed & before.keys() & after.keys():
        worked, passed = (after[core][k] - before[core][k] for k in range(2))
        if passed > 0:  # else the system does not say
            load[core] = worked / passed
    return sorted((core for core, share in load.items() if share < BUSY_SHARE), key=lambda core: (load[core], core))


def _times(counters: Path) -> dict[int, tuple[int, int]]:
    """Return each core's busy ticks and all ticks since boot (proc(5))."""
    times = {}
    for line in counters.read_text().splitlines():
        name, *ticks = line.split()
        if name.startswith("cpu") and name != "cpu":
            counts = [int(tick) for tick in ticks[:8]]
            idle = counts[3] + counts[4]  # idle, and waiting for a disk
            times[int(name[3:])] = sum(counts) - idle, sum(counts)
    return times


def _lock(core: int) -> int | None:
    """Return an open file that holds the core, or None: two commands may then choose it, which is only slower."""
    folder = Path(tempfile.gettempdir(), f"perdure-{os.getuid()}")
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        if folder.lstat().st_uid != os.getuid():  # somebody else's may lead anywhere
            return None
        return acquire(folder / f"core-{core}.lock")
    except (OSError, PerdureError):
        return None
