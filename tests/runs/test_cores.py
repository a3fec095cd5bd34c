"""Which cores are free, and that two commands do not choose the same ones."""

import os
from contextlib import nullcontext

import pytest

from perdure.runs import Store, Unit
from perdure.runs.workers import answer_on_node, idle_cores, own_cores


class TestIdleCores:
    def look(self, tmp_path, monkeypatch, before, after):
        """What is found idle when the system's counts go from one to the other while one looks."""
        stat = tmp_path / "stat"

        def write(counts):
            rows = [f"cpu{core} {' '.join(map(str, row))} 0 0" for core, row in counts.items()]
            stat.write_text("\n".join(["cpu 1 2 3 4 5 6 7 8 9 10", *rows, "intr 5"]))

        write(before)
        monkeypatch.setattr("perdure.runs.workers.time.sleep", lambda seconds: write(after))
        monkeypatch.setattr("perdure.runs.workers.os.sched_getaffinity", lambda process: {0, 1, 3})
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
        monkeypatch.setattr("perdure.runs.workers.idle_cores", lambda: [2, 0, 1])
        monkeypatch.setattr("perdure.runs.workers.tempfile.gettempdir", lambda: str(tmp_path))
        with own_cores(2) as mine, own_cores(2) as others:
            assert (mine, others) == ([2, 0], [1])
        with own_cores(3) as mine:
            assert mine == [2, 0, 1]

    def test_where_there_can_be_no_locks_there_are_no_cores_of_ones_own(self, tmp_path, monkeypatch):
        monkeypatch.setattr("perdure.runs.workers.idle_cores", lambda: [0])
        monkeypatch.setattr("perdure.runs.workers.tempfile.gettempdir", lambda: str(tmp_path))
        (tmp_path / f"perdure-{os.getuid()}").write_text("not a folder")
        with own_cores(1) as mine:
            assert mine == []

    def test_locks_in_a_folder_of_somebody_else_are_not_opened(self, tmp_path, monkeypatch):
        monkeypatch.setattr("perdure.runs.workers.idle_cores", lambda: [0])
        monkeypatch.setattr("perdure.runs.workers.tempfile.gettempdir", lambda: str(tmp_path))
        monkeypatch.setattr("perdure.runs.workers.os.getuid", lambda: 12345)
        (tmp_path / "perdure-12345").mkdir()
        (tmp_path / "perdure-12345" / "core-0.lock").symlink_to(tmp_path / "elsewhere")
        with own_cores(1) as mine:
            assert mine == []
        assert not (tmp_path / "elsewhere").exists()

    def test_on_this_machine_they_are_cores_of_ours(self):
        assert set(idle_cores()) <= os.sched_getaffinity(0)


def test_a_task_on_a_cluster_is_bound_to_an_idle_core_and_released(tmp_path, monkeypatch):
    every = os.sched_getaffinity(0)
    if len(every) < 2:
        pytest.skip("one core: bound or not is the same")
    monkeypatch.setattr("perdure.runs.workers.own_cores", lambda count: nullcontext([max(every)]))
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
    unit = Unit("u", {}, "tests.runs.scripted_units:where")
    assert answer_on_node(str(tmp_path), unit, 1) == {"result": "finished"}
    assert (Store(tmp_path).get("u") / "where").read_text().startswith(f"[{max(every)}] ")
    assert os.sched_getaffinity(0) == every
