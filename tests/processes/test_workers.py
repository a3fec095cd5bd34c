"""Worker processes: answers come as they are told, failures say why, and nothing outlives who asked."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from perdure.processes import WorkerError, WorkerProcess, idle_cores, own_cores, share_out

MODULE = """
import os, sys, time
from perdure.processes import serve

def work(job, tell):
    print("noise on standard output")
    if job == "fail":
        raise ValueError("no such job")
    if job == "long":
        tell(os.getpid())
        time.sleep(300)
    if job == "where":
        tell([sorted(os.sched_getaffinity(0)), os.environ["OPENBLAS_NUM_THREADS"], os.getpid()])
        return
    for k in range(job):
        tell(k)
        time.sleep(0.05 if job > 100 else 0.0)

serve(work)
"""

ASKS = """
import sys
from perdure.processes import WorkerProcess

with WorkerProcess("scripted_worker") as worker:
    for answer in worker.ask("long"):
        print(answer, flush=True)
"""

SHARES = """
import sys
from perdure.processes import share_out

share_out("scripted_worker", ["long", "long"], 2, lambda job, told: print(told, flush=True))
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    (tmp_path / "scripted_worker.py").write_text(textwrap.dedent(MODULE))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return "scripted_worker"


def test_jobs_are_done_one_after_the_other_by_one_process(module):
    with WorkerProcess(module) as worker:
        assert list(worker.ask(3)) == [0, 1, 2]
        assert list(worker.ask(0)) == []
        (first, second) = (list(worker.ask("where")) for _ in range(2))
    assert first == second
    assert first[0][2] != os.getpid()


def test_it_runs_on_the_cores_it_is_given_with_one_thread(module):
    core = min(os.sched_getaffinity(0))
    with WorkerProcess(module, [core]) as worker:
        ((cores, threads, _),) = worker.ask("where")
    assert (cores, threads) == ([core], "1")


def test_a_failure_reaches_who_asked(module):
    with WorkerProcess(module) as worker, pytest.raises(WorkerError, match="ValueError: no such job"):
        list(worker.ask("fail"))


def test_a_killed_worker_is_a_failure_and_so_is_asking_it_again(module):
    with WorkerProcess(module) as worker:
        ((_, _, process),) = worker.ask("where")
        os.kill(process, signal.SIGKILL)
        for _ in range(2):
            with pytest.raises(WorkerError, match="SIGKILL"):
                list(worker.ask(3))


def test_a_worker_ends_with_who_asked_however_that_ended(module):
    asking, (worker,) = asked(ASKS, 1)
    asking.kill()
    until_gone(worker)
    asking.communicate(timeout=30)


@pytest.mark.parametrize("how", ["killed", "Ctrl-C"])
def test_a_crew_ends_with_who_asked_for_it(module, how):
    asking, workers = asked(SHARES, 2)  # without a main guard
    if how == "Ctrl-C":
        os.killpg(asking.pid, signal.SIGINT)  # as a terminal does
    else:
        asking.kill()
    until_gone(*workers)
    assert asking.communicate(timeout=30)[1].count("Traceback") == (how == "Ctrl-C"), "its own alone"


def test_a_crew_does_every_job_once_each_process_on_one_thread(module):
    told = []
    share_out(module, [3, "where", 2, "where", 0], 2, lambda job, news: told.append((job, news)))
    assert sorted(news for job, news in told if job in (0, 2)) == [0, 0, 1, 1, 2]
    (_, (cores, threads, first)), (_, (_, _, second)) = sorted(each for each in told if each[0] in (1, 3))
    assert threads == "1"
    assert set(cores) <= os.sched_getaffinity(0)
    assert os.getpid() not in (first, second)


def test_a_crew_without_jobs_is_none(module):
    share_out(module, [], 2, print)


def test_a_failure_in_a_crew_ends_the_others_and_reaches_who_asked(module):
    workers = []
    with pytest.raises(WorkerError, match="ValueError: no such job"):
        share_out(module, ["long", "fail"], 2, lambda job, process: workers.append(process))
    until_gone(*workers)


def asked(script, count):
    """A script that runs, and what it printed first: the numbers of its worker processes."""
    asking = subprocess.Popen(
        [sys.executable, "-c", script],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    return asking, [int(asking.stdout.readline()) for _ in range(count)]


def until_gone(*processes):
    end = time.monotonic() + 60.0
    while any(_alive(process) for process in processes):
        assert time.monotonic() < end, "it lives on"
        time.sleep(0.05)


def _alive(process):
    try:
        return "State:\tZ" not in Path(f"/proc/{process}/status").read_text()
    except (FileNotFoundError, ProcessLookupError):  # gone, the second while its file was being read
        return False


class TestIdleCores:
    def look(self, tmp_path, monkeypatch, before, after):
        """What is found idle when the system's counts go from one to the other while one looks."""
        stat = tmp_path / "stat"

        def write(counts):
            rows = [f"cpu{core} {' '.join(map(str, row))} 0 0" for core, row in counts.items()]
            stat.write_text("\n".join(["cpu 1 2 3 4 5 6 7 8 9 10", *rows, "intr 5"]))

        write(before)
        monkeypatch.setattr("perdure.processes.cores.time.sleep", lambda seconds: write(after))
        monkeypatch.setattr("perdure.processes.cores.os.sched_getaffinity", lambda process: {0, 1, 3})
        return idle_cores(stat)

    def test_cores_with_least_to_do_come_first_and_busy_or_forbidden_ones_not_at_all(self, tmp_path, monkeypatch):
        idle, waiting = [0, 0, 0, 20, 0, 0, 0, 0], [0, 0, 0, 0, 20, 0, 0, 0]
        a_little, busy = [4, 0, 0, 16, 0, 0, 0, 0], [15, 0, 2, 3, 0, 0, 0, 0]
        zero = dict.fromkeys(range(4), [0] * 8)
        after = {0: a_little, 1: waiting, 2: idle, 3: busy}
        assert self.look(tmp_path, monkeypatch, zero, after) == [1, 0]
        assert self.look(tmp_path, monkeypatch, zero, {**after, 3: idle}) == [1, 3, 0]

    def test_where_the_system_says_nothing_there_is_none(self, tmp_path, monkeypatch):
        assert idle_cores(tmp_path / "missing") == []
        still = {0: [7] * 8, 1: [7] * 8}
        assert self.look(tmp_path, monkeypatch, still, still) == []

    def test_a_core_is_taken_once_and_free_again_afterwards(self, tmp_path, monkeypatch):
        monkeypatch.setattr("perdure.processes.cores.idle_cores", lambda: [2, 0, 1])
        monkeypatch.setattr("perdure.processes.cores.tempfile.gettempdir", lambda: str(tmp_path))
        with own_cores(2) as mine, own_cores(2) as others:
            assert (mine, others) == ([2, 0], [1])
        with own_cores(3) as mine:
            assert mine == [2, 0, 1]

    def test_a_file_that_another_user_left_in_a_shared_folder_holds_a_core_as_well(self, tmp_path, monkeypatch):
        def guarded(path, flags, mode=0o777, usual=os.open):
            if flags & os.O_CREAT and Path(path).exists():
                raise PermissionError(path)  # as Linux with fs.protected_regular
            return usual(path, flags, mode)

        monkeypatch.setattr("perdure.processes.cores.idle_cores", lambda: [0])
        monkeypatch.setattr("perdure.processes.cores.tempfile.gettempdir", lambda: str(tmp_path))
        (tmp_path / "perdure-core-0.lock").touch()
        monkeypatch.setattr("perdure.processes.cores.os.open", guarded)
        with own_cores(1) as mine, own_cores(1) as others:
            assert (mine, others) == ([0], [])

    def test_on_this_machine_they_are_cores_of_ours(self):
        assert set(idle_cores()) <= os.sched_getaffinity(0)
