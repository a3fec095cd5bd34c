"""A module that runs as a process of its own: it takes jobs, one after the other, and tells how they get on.

Jobs and answers are JSON, a line each. A process that is started this way, rather than by `multiprocessing`, does not
import the caller's script again, so that a script without a main guard may train.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Self

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment of a process whose libraries shall multiply on one thread from their first import on."""

Tell = Callable[[Any], None]
LOOK = 0.5
"""Seconds between two looks at whether the process that asked still lives."""
_DONE = None
"""What a worker answers when a job is done; nothing a job tells."""


class WorkerError(ValueError):
    """A worker process ended before its job did. Says why in one line."""


class WorkerProcess:
    """The side that asks. As a context manager it ends the process, whatever that is doing."""

    def __init__(self, module: str, cores: Sequence[int] = ()) -> None:
        """Starts ``python -m module``, which calls `serve`.

        Args:
            module: Its name.
            cores: Cores it runs on; wherever it likes when there are none.
        """
        self._process = subprocess.Popen(
            [sys.executable, "-m", module, json.dumps(list(cores))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, **ONE_THREAD},
        )
        self._errors: deque[str] = deque(maxlen=50)
        # Both pipes are read, or a full one would stop the worker.
        self._reader = threading.Thread(target=lambda: self._errors.extend(self._process.stderr or ()), daemon=True)
        self._reader.start()

    def ask(self, job: Any) -> Iterator[Any]:
        """Hands over a job and gives what is told about it, until it is done; to be read to its end.

        Raises:
            WorkerError: If the process ended before; the signal that ended it, or the last line it wrote, says why.
        """
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # its end is found below, and why
            self._process.stdin.write(json.dumps(job) + "\n")
            self._process.stdin.flush()
        for line in self._process.stdout or ():
            answer = json.loads(line)
            if answer is _DONE:
                return
            yield answer
        code = self._process.wait()
        self._reader.join()
        if code < 0:
            raise WorkerError(f"a worker process was ended by {signal.Signals(-code).name}")
        raise WorkerError(
            f"a worker process failed: {self._errors[-1].strip() if self._errors else f'exit code {code}'}"
        )

    def kill(self) -> None:
        """Ends the process now; whoever waits for an answer gets a `WorkerError`."""
        self._process.kill()

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(self, *exception: object) -> None:
        """Ends the process."""
        self._process.kill()
        self._process.wait()
        self._reader.join()
        for pipe in (self._process.stdin, self._process.stdout, self._process.stderr):
            with contextlib.suppress(BrokenPipeError):  # a job that was never read
                if pipe is not None:
                    pipe.close()


def serve(work: Callable[[Any, Tell], None]) -> None:
    """The side that works: does every job it is handed, until there are no more or the process that asked is gone.

    Args:
        work: Called with a job and with whom to tell how it gets on. What it prints goes to standard error.
    """
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Python's own handler would print where it was
    if cores := json.loads(sys.argv[1]):
        os.sched_setaffinity(0, cores)
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()

    def tell(answer: Any) -> None:
        answers.write(json.dumps(answer) + "\n")
        answers.flush()

    for line in sys.stdin:
        work(json.loads(line), tell)
        tell(_DONE)


def _end_with(parent: int) -> None:
    """Ends this process when its parent is gone, however that ended. Files are written whole, so none is left half."""
    while os.getppid() == parent:
        time.sleep(LOOK)
    os._exit(1)
