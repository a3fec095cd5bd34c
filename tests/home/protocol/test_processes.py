"""Work spread over processes: all of it is done, and nothing outlives the process that asked for it."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from perdure.home.protocol.processes import work_through

SCRIPT = """
import os, sys, time
from pathlib import Path
from perdure.home.protocol.processes import work_through

def work(path, told):
    Path(path).write_text(str(os.getpid()))
    time.sleep(120)

if __name__ == "__main__":
    work_through(work, sys.argv[1:], 2, print)
"""


def leave_a_mark(path, told):
    told(1)
    path.write_text(f"{os.getpid()} {os.environ.get('OPENBLAS_NUM_THREADS')}")
    told(2)


def refuse(number, told):
    raise ValueError(f"not {number}")


@pytest.mark.parametrize("processes", [1, 2])
def test_every_job_is_done_and_told_of_once(tmp_path, processes, monkeypatch):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "7")
    jobs, told = [tmp_path / str(number) for number in range(5)], []
    work_through(leave_a_mark, jobs, processes, told.append)
    assert sorted(told) == [1] * 5 + [2] * 5
    marks = [job.read_text().split() for job in jobs]
    assert {int(who) == os.getpid() for who, _ in marks} == {processes == 1}
    assert {threads for _, threads in marks} == {"1" if processes > 1 else "7"}
    assert os.environ["OPENBLAS_NUM_THREADS"] == "7"


@pytest.mark.parametrize("processes", [1, 2])
def test_a_failure_reaches_the_caller(processes):
    with pytest.raises(ValueError, match="not 3"):
        work_through(refuse, [3, 3], processes, print)


@pytest.mark.parametrize("to_all", [False, True], ids=["killed", "Ctrl-C"])
def test_nothing_outlives_its_parent(tmp_path, to_all):
    script, marks = tmp_path / "script.py", [tmp_path / "first", tmp_path / "second"]
    script.write_text(textwrap.dedent(SCRIPT))
    asked = subprocess.Popen(
        [sys.executable, str(script), *map(str, marks)], start_new_session=True, stderr=subprocess.PIPE, text=True
    )
    _until(lambda: all(mark.exists() and mark.read_text() for mark in marks))
    workers = [int(mark.read_text()) for mark in marks]
    if to_all:
        os.killpg(asked.pid, signal.SIGINT)  # as a terminal does
    else:
        asked.kill()
    _until(lambda: not any(_alive(worker) for worker in workers))
    told = asked.communicate(timeout=30)[1]
    assert "SpawnProcess" not in told  # no worker printed a traceback


def _alive(process):
    try:
        return "State:\tZ" not in Path(f"/proc/{process}/status").read_text()
    except (FileNotFoundError, ProcessLookupError):  # gone, the second while its file was being read
        return False


def _until(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it never happened"
        time.sleep(0.05)
