"""Units run once each, in order, on whatever workers; failures say why; nothing outlives its command."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from perdure.errors import PerdureError, note_call
from perdure.runs import LocalWorkers, Store, Unit, make_workers, progress, read_unit_progress, run_missing, workers
from perdure.runs.progress import show_progress
from perdure.runs.run import UnitProgress

HERE = Path(__file__).parent


@pytest.fixture(autouse=True)
def importable(monkeypatch):
    monkeypatch.syspath_prepend(str(HERE))


def unit(key, name="write", after=(), **arguments):
    arguments = arguments or {"text": key}
    return Unit(key, {"name": name, "key": key}, f"scripted_units:{name}", arguments, tuple(after))


def lines(path):
    return Path(path).read_text().splitlines() if Path(path).exists() else []


@pytest.fixture(params=["here", "local"])
def on(request):
    return request.param


def test_every_unit_runs_once_and_a_finished_one_never_again(tmp_path, on):
    log = tmp_path / "log"
    units = [unit(f"u-{k}", text=f"text {k}", log=str(log)) for k in range(5)]
    for cores in (1, 2):  # another number of workers changes nothing
        run_missing(units, tmp_path / "store", on, cores)
    assert sorted(lines(log)) == [f"text {k}" for k in range(5)]
    store = Store(tmp_path / "store")
    assert [(store.get(each.key) / "text").read_text() for each in units] == [f"text {k}" for k in range(5)]
    assert not list(store.root.glob(".progress/*"))


def test_a_unit_comes_after_those_it_depends_on(tmp_path, on):
    log = str(tmp_path / "log")
    units = [
        unit("third", after=("second",), text="3", log=log),
        unit("second", after=("first",), text="2", log=log),
        unit("first", text="1", log=log),
    ]
    run_missing(units, tmp_path / "store", on, 2)
    assert lines(log) == ["1", "2", "3"]


def test_of_units_with_checkpoints_the_one_furthest_behind_goes_first(tmp_path):
    log = tmp_path / "log"
    units = [unit("long", "count", to=4, log=str(log)), unit("short", "count", to=2, log=str(log))]
    run_missing(units, tmp_path / "store")
    assert lines(log) == ["4:1", "2:1", "4:2", "4:3", "2:2", "4:4"], "a tie goes to the first"


def test_units_beyond_two_for_each_worker_wait_until_earlier_ones_are_finished(tmp_path):
    log = tmp_path / "log"
    units = [unit(str(number), "count", to=number, log=str(log)) for number in (3, 2, 1)]
    run_missing(units, tmp_path / "store")
    assert lines(log) == ["3:1", "2:1", "3:2", "2:2", "1:1", "3:3"]


def test_a_failure_is_said_recorded_and_stops_only_what_depends_on_it(tmp_path, on):
    units = [unit("bad", "fail", message="no such thing"), unit("next", after=("bad",)), unit("good")]
    seen = []
    with pytest.raises(PerdureError, match=r"1 of 3 units failed, 1 depend on them: bad: ValueError: no such thing"):
        run_missing(units, tmp_path, on, 2, lambda status: seen.append(dict(status)))
    assert Store(tmp_path).keys() == ("good",)
    assert [seen[-1][each.key].state for each in units] == ["failed", "blocked", "finished"]
    assert "no such thing" in Store(tmp_path).note_path("failures", "bad").read_text()


def test_a_failure_is_forgotten_when_the_unit_succeeds(tmp_path):
    bad = unit("unit", "die", log=str(tmp_path / "log"))
    with pytest.raises(PerdureError, match="SIGKILL"):
        run_missing([bad], tmp_path / "store", "local", 1)
    run_missing([bad], tmp_path / "store", "local", 1)
    assert not Store(tmp_path / "store").note_path("failures", "unit").exists()
    assert (Store(tmp_path / "store").get("unit") / "text").read_text() == "second life"


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("exit", "its process ended with exit code 3 in mine, lane 0, step 3: step"),
        ("kill", "its process was ended by SIGTERM in mine, lane 0, step 3: step"),
        ("interrupt", "KeyboardInterrupt"),
    ],
)
def test_the_end_of_a_process_is_blamed_on_what_it_was_calling(tmp_path, how, said):
    with pytest.raises(PerdureError) as failure:
        run_missing([unit("unit", "end", how=how)], tmp_path, "local", 1)
    assert str(failure.value) == f"1 of 1 units failed: unit: {said}"


def test_a_unit_finds_nothing_on_standard_input(tmp_path):
    """Not the arguments of the next unit, which its process gets there."""
    run_missing([unit("first", "read_input"), unit("second", "read_input")], tmp_path, "local", 1)
    assert [(Store(tmp_path).get(key) / "text").read_bytes() for key in ("first", "second")] == [b"", b""]


def test_a_call_that_lasts_is_named(monkeypatch, capsys):
    monkeypatch.setattr(progress, "HANG_SECONDS", 0.01)
    progress._watch_calls.__wrapped__()
    with show_progress("test"):
        note_call("mine, lane 0: reset")
        while not (printed := capsys.readouterr().err):
            time.sleep(0.01)
        note_call("")
    assert "  still in mine, lane 0: reset, for more than 0.01 s" in printed


def test_a_killed_worker_is_replaced_for_the_units_that_wait(tmp_path):
    units = [unit("dies", "die", log=str(tmp_path / "log")), *(unit(f"u-{k}") for k in range(3))]
    with pytest.raises(PerdureError, match="1 of 4"):
        run_missing(units, tmp_path / "store", "local", 1)
    assert len(Store(tmp_path / "store").keys()) == 3


def test_a_worker_runs_on_the_cores_it_is_given_with_one_thread(tmp_path):
    where = Unit("where", {}, "scripted_units:where")
    run_missing([where], tmp_path, "local", 1)
    text = (Store(tmp_path).get("where") / "where").read_text()
    cores, threads, blas, process = text.rsplit(" ", 3)
    assert set(json.loads(cores)) <= os.sched_getaffinity(0)
    assert (threads, blas) == ("1", "1")
    assert int(process) != os.getpid()


def test_progress_is_seen_by_other_processes_while_it_runs(tmp_path):
    units = [unit("unit", "count", to=3, log=str(tmp_path / "log"))]
    seen = []
    run_missing(units, tmp_path / "store", observe=lambda status: seen.append(status["unit"].share))
    assert seen == sorted(seen)
    assert seen[-1] == 1.0
    assert {round(share, 2) for share in seen} >= {0.33, 0.67}
    assert read_unit_progress(Store(tmp_path / "store"), units[0]).state == "finished"


def test_two_commands_on_one_store_share_the_work(tmp_path):
    log = tmp_path / "log"
    units = [unit(f"u-{k}", "sleep", log=str(log), seconds=0.4) for k in range(4)]
    others = [threading.Thread(target=run_missing, args=(units, tmp_path / "store", "local", 1)) for _ in range(2)]
    for each in others:
        each.start()
    for each in others:
        each.join()
    assert len(lines(log)) == 4, "each unit ran once"
    assert len(set(lines(log))) == 2, "by both"
    assert len(Store(tmp_path / "store").keys()) == 4


def test_the_current_folder_is_not_imported_from(tmp_path, monkeypatch):
    trap = tmp_path / "trap"
    trap.mkdir()
    for name in ("json", "threading", "numpy", "scripted_units"):
        (trap / f"{name}.py").write_text(f"open({str(tmp_path / 'sprung')!r}, 'w')\n")
    monkeypatch.chdir(trap)
    run_missing([unit("unit")], tmp_path / "store", "local", 1)
    assert not (tmp_path / "sprung").exists()


@pytest.mark.parametrize("text", ["ray:", "cloud", "", "locally"])
def test_a_place_that_is_none_is_refused(text):
    with pytest.raises(PerdureError, match="local"):
        make_workers(text, [unit("unit")])


def test_two_units_of_one_key_and_a_missing_dependency_are_refused(tmp_path):
    with pytest.raises(PerdureError, match="'a'"):
        run_missing([unit("a"), unit("a")], tmp_path)
    with pytest.raises(PerdureError, match="'b'"):
        run_missing([unit("a", after=("b",))], tmp_path)


def test_without_a_terminal_a_line_is_printed_every_half_minute(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("perdure.runs.progress.LINE_SECONDS", 0.0)
    units = [unit("a", "count", to=2, log=str(tmp_path / "log")), unit("b")]
    with show_progress("test", "steps") as observe:
        run_missing(units, tmp_path / "store", observe=observe)
    printed = capsys.readouterr().err.splitlines()
    assert "test  0%  0 of 2 done" in printed[0]
    assert "test  100%  2 of 2 done" in printed[-1]


def test_what_was_done_before_a_resume_is_not_work_of_this_command(monkeypatch, capsys):
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    monkeypatch.setattr("perdure.runs.progress.LINE_SECONDS", 0.0)
    with show_progress("test", "steps") as observe:
        observe({"a": UnitProgress("waiting", total=1000.0)})
        observe({"a": UnitProgress("running", 300.0, 1000.0)})  # from its checkpoint
        now[0] = 60.0
        observe({"a": UnitProgress("running", 400.0, 1000.0)})
    assert "test  40%  2 steps/s  6 min left" in capsys.readouterr().err.splitlines()[-1]


ASKS = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # what runs in the background ignores it
sys.path.insert(0, sys.argv[1])
from perdure.runs import Unit, run_missing

units = [Unit(f"u-{k}", {}, "scripted_units:stuck", {"log": sys.argv[3], "seconds": 3000}) for k in range(2)]
run_missing(units, sys.argv[2], "local", 2)
"""


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_workers_end_with_their_command_however_it_ends(tmp_path, how):
    log = tmp_path / "log"
    command = [sys.executable, "-c", ASKS, str(HERE), str(tmp_path / "store"), str(log)]  # without a main guard
    asking = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    wait_until(lambda: len(lines(log)) == 2, 600)
    workers = [int(line) for line in lines(log)]
    if how == signal.SIGINT:
        os.killpg(asking.pid, how)  # as a terminal does
    else:
        asking.kill()
    wait_until(lambda: not any(map(alive, workers)), 600)
    assert asking.communicate(timeout=600)[1].count("Traceback") == (how == signal.SIGINT), "its own alone"
    assert Store(tmp_path / "store").keys() == ()


def wait_until(condition, seconds):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def alive(process):
    try:
        return "State:\tZ" not in Path(f"/proc/{process}/status").read_text()
    except (FileNotFoundError, ProcessLookupError):  # gone, the second while its file was being read
        return False


def test_a_worker_ends_whose_parent_ended_while_it_started():
    parent = subprocess.Popen(["true"])
    parent.wait()
    command = [sys.executable, "-P", "-c", workers._START, json.dumps(sys.path), "[]", str(parent.pid)]
    worker = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert worker.wait(60) == 1
    worker.stdin.close()
    worker.stdout.close()


def test_a_worker_that_dies_while_idle_stops_nothing(tmp_path):
    """The first unit ends, its worker is killed while it waits, and the others go on."""
    units = [unit(f"row/{k}") for k in range(2)]
    pool = LocalWorkers(2)
    with pool:
        pool.start(tmp_path / "store", units[0])
        while not pool.wait(1.0):
            pass
        (idle,) = pool._idle
        os.kill(idle._process.pid, signal.SIGKILL)
        idle._process.wait()
        assert pool.wait(1.0) == []
        assert pool.free == 2
        pool.start(tmp_path / "store", units[1])
        ended = []
        while not ended:
            ended = pool.wait(1.0)
        assert [(each.key, each.error) for each in ended] == [("row/1", "")]
