"""Functions of units, for tests of the runner."""

import ctypes
import os
import signal
import sys
import time
from pathlib import Path

from perdure.errors import note_call


def write(work, *, text, log=None):
    """Leaves a file; notes in `log` that it ran."""
    print("noise on standard output")
    work.report(1, 1, length=len(text))
    (work.folder / "text").write_text(text)
    if log is not None:
        with Path(log).open("a") as file:
            file.write(f"{text}\n")


def count(work, *, to, log):
    """One step of several: a checkpoint in the folder, a line in the log."""
    path = work.folder / "count"
    done = int(path.read_text()) + 1 if path.exists() else 1
    path.write_text(str(done))
    work.report(done, to)
    with Path(log).open("a") as file:
        file.write(f"{to}:{done}\n")
    return done >= to


def where(work):
    cores = sorted(os.sched_getaffinity(0))
    (work.folder / "where").write_text(f"{cores} {work.threads} {os.environ['OPENBLAS_NUM_THREADS']} {os.getpid()}")


def read_input(work, **arguments):
    """Leaves what it can read on standard input."""
    (work.folder / "text").write_bytes(sys.stdin.buffer.read())


def fail(work, *, message):
    raise ValueError(message)


def die(work, *, log):
    """Kills its process the first time."""
    if not Path(log).exists():
        Path(log).write_text("died")
        os.kill(os.getpid(), signal.SIGKILL)
    (work.folder / "text").write_text("second life")


def sleep(work, *, log, seconds, text="slept"):
    with Path(log).open("a") as file:
        file.write(f"{os.getpid()}\n")
    time.sleep(seconds)
    (work.folder / "text").write_text(text)


def stuck(work, *, log, seconds):
    """Sleeps in a call that lets no other thread of the process run."""
    with Path(log).open("a") as file:
        file.write(f"{os.getpid()}\n")
    ctypes.PyDLL(None).sleep(seconds)


def end(work, *, how):
    """Ends its process, or tries to, in the middle of a step of an environment."""
    note_call("mine, lane 0, step 3: step")
    if how == "interrupt":
        raise KeyboardInterrupt
    if how == "exit":
        os._exit(3)
    os.kill(os.getpid(), signal.SIGTERM)
