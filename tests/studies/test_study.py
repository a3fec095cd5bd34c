"""Steps are carried out in order; what fails stops only what depends on it; status and cost are read from stores."""

import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from perdure.runs import OtherSourceWarning, RunError, Store, StoreError, Unit, UnitProgress, attempt, run_units
from perdure.studies import RunOptions, StepProgress, StudyError, find_study
from perdure.studies.run import check_page, check_results, run_steps
from perdure.studies.status import cost_text, count_units, failed_steps, lines, read_step_progress, status_text


@dataclass
class Scripted:
    key: str
    log: list = field(default_factory=list)
    after: tuple = ()
    fails: bool = False
    done: int = 0
    stage: str = "training"
    task: str = "Hopper-v3"
    amount: float = 1000.0
    measure: str = "training steps"

    def seconds(self, speed):
        return self.amount / speed

    def progress(self):
        return StepProgress(2, self.done, running=1 - self.done // 2, failed=int(self.fails), share=self.done / 2)

    def run(self, options):
        self.log.append(self.key)
        if self.fails:
            raise RunError("broken")
        options.observe({})


def test_steps_run_in_order_and_a_failure_stops_only_what_depends_on_it():
    log = []
    steps = [
        Scripted("a", log, fails=True),
        Scripted("b", log, after=("a",)),
        Scripted("c", log),
        Scripted("d", log, after=("c",)),
        Scripted("e", log, after=("b",)),
    ]
    with pytest.raises(RunError, match="3 of 5 steps failed: a: broken"):
        run_steps(steps, RunOptions("here"))
    assert log == ["a", "c", "d"]


@dataclass
class Busy(Scripted):
    """Another command is running it for the first `times` attempts."""

    times: int = 0

    def run(self, options):
        self.log.append(self.key)
        self.times -= 1
        if self.times >= 0:
            options.waiting()


@pytest.fixture
def pauses(monkeypatch):
    """The pauses between attempts, which take no time."""
    found = []
    monkeypatch.setattr("perdure.studies.run.time.sleep", found.append)
    return found


def test_a_step_that_another_command_runs_is_put_off_and_tried_again(pauses):
    log = []
    steps = [Busy("a", log, times=4), Scripted("b", log, after=("a",)), Busy("c", log, times=1), Scripted("d", log)]
    states = []
    observe = lambda status: states.append(status["a"].state)  # noqa: E731
    run_steps(steps, RunOptions("here", observe=observe, waiting=lambda: log.append("waits")))
    assert log == ["a", "c", "d", "a", "c", "a", "waits", "a", "a", "b"]
    assert pauses == [1.0, 2.0]
    assert list(dict.fromkeys(states)) == ["busy", "finished"]


def test_what_becomes_free_is_taken_while_other_steps_are_still_busy(pauses):
    log = []
    steps = [Busy("a", log, times=5), Busy("c", log, times=2), Scripted("d", log, after=("c",))]
    run_steps(steps, RunOptions("here"))
    assert log == ["a", "c", "a", "c", "a", "c", "d", "a", "a", "a"]


def test_a_step_that_is_put_off_keeps_its_progress():
    seen = []

    class Half(Busy):
        def run(self, options):
            options.observe({"unit": UnitProgress("running", 1.0, 2.0)})
            super().run(options)

    observe = lambda status: seen.append(status.get("a"))  # noqa: E731
    run_steps([Half("a", [], times=1), Scripted("b", [])], RunOptions("here", observe=observe))
    assert next(each.share for each in seen if each is not None and each.state == "busy") == 0.5


def test_a_warning_about_reused_results_counts_steps_not_attempts(pauses):
    class Warns(Busy):
        def run(self, options):
            warnings.warn("made by another version", OtherSourceWarning, stacklevel=2)
            warnings.warn("something else", UserWarning, stacklevel=2)
            super().run(options)

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        run_steps([Warns("a", [], times=3), Warns("b", [])], RunOptions("here"))
    texts = [str(each.message) for each in caught]
    assert [text[:18] for text in texts] == ["something else", "results of 2 steps"]


def test_a_step_that_fails_after_it_was_put_off_stops_what_depends_on_it(pauses):
    log = []

    class Fails(Busy):
        def run(self, options):
            super().run(options)
            raise RunError("broken")

    steps = [Fails("a", log, times=1), Scripted("b", log, after=("a",)), Scripted("c", log)]
    with pytest.raises(RunError, match="2 of 3 steps failed: a: broken"):
        run_steps(steps, RunOptions("here"))
    assert log == ["a", "c", "a"]


def test_a_fault_of_the_program_is_not_hidden():
    broken = Scripted("a")
    broken.run = lambda options: int("no number")
    with pytest.raises(ValueError, match="invalid literal"):
        run_steps([broken], RunOptions("here"))


def test_the_observer_sees_the_whole_study():
    seen = []
    run_steps([Scripted("a"), Scripted("b")], RunOptions("here", observe=lambda status: seen.append(dict(status))))
    assert {key: each.state for key, each in seen[-1].items()} == {"a": "finished", "b": "finished"}
    assert {key: each.state for key, each in seen[1].items()} == {"a": "finished", "b": "waiting"}


def test_cost_counts_what_is_left():
    steps = [Scripted("a", done=1), Scripted("b"), Scripted("c", stage="evaluation", amount=7200.0)]
    found = lines(steps, read_step_progress(steps), {"Hopper-v3": 1.0}, cores=2)
    assert [line.left for line in found] == [1500.0, 7200.0]
    assert [line.hours for line in found] == pytest.approx([1500 / 3600 / 2, 1.0])
    assert "1,500 of 2,000 training steps left, 12 min" in cost_text(found, 2)
    assert "together 72 min on 2 cores" in cost_text(found, 2)


def test_status_counts_units():
    steps = [Scripted("a", done=2), Scripted("b", fails=True)]
    counts = read_step_progress(steps)
    assert "2 of 4 units done, 1 running, 1 failed (50% of the work)" in status_text(lines(steps, counts))
    assert failed_steps(steps, counts) == ["b"]


def note(work, done, total):
    """Report progress and leave the unit unfinished."""
    work.report(done, total)
    return False


def done(work):
    """Finish at once."""


def fail(work):
    raise OSError("disk full")


UNITS = (
    Unit("row/a", {"seed": 0}, f"{__name__}:note", {"done": 3, "total": 4}, size=10.0),
    Unit("row/b", {"seed": 1}, f"{__name__}:fail", {}, size=20.0),
    Unit("row/c", {"seed": 2}, f"{__name__}:note", {}, size=30.0),
)


def test_units_of_a_store_are_counted_by_their_work(tmp_path):
    sizes, store = {unit.key: unit.size for unit in UNITS}, Store(tmp_path / "store")
    assert count_units(store.root, sizes) == StepProgress(3, 0)
    attempt(store.root, UNITS[0])
    with pytest.raises(OSError, match="disk full"):
        run_units(UNITS[1:2], store.root)
    with store.workspace("row/c", UNITS[2].config):
        running = count_units(store.root, sizes)
    assert running == StepProgress(3, 0, running=1, failed=1, share=10.0 * 3 / 4 / 60.0)
    finished = count_units(store.root, sizes, {unit.key: unit.config for unit in UNITS})
    assert finished == StepProgress(3, 1, running=0, failed=1, share=(10.0 * 3 / 4 + 30.0) / 60.0)


def test_a_run_says_when_only_other_commands_units_are_left(tmp_path):
    class OtherError(Exception):
        pass

    def told():
        raise OtherError

    store = Store(tmp_path / "store")
    units = (Unit("row/a", {}, f"{__name__}:done"), Unit("row/b", {}, f"{__name__}:done"))
    with store.workspace("row/a", {}), pytest.raises(OtherError):
        run_units(units, store.root, waiting=told)
    assert store.done("row/b")
    run_units(units, store.root, waiting=told)


def test_a_unit_that_failed_is_not_run_again_while_others_are_waited_for(tmp_path):
    """Where a unit has failed, the run waits for other commands instead of being put off."""
    store = Store(tmp_path / "store")
    units = (Unit("row/a", {}, f"{__name__}:done"), Unit("row/b", {}, f"{__name__}:fail"))
    with ThreadPoolExecutor() as pool:
        with store.workspace("row/a", {}):
            run = pool.submit(run_units, units, store.root, waiting=lambda: pytest.fail("put off"))
            time.sleep(0.5)
            assert not run.done()
        with pytest.raises(RunError, match="row/b"):
            run.result(timeout=60)


def test_a_finished_unit_of_another_config_is_not_counted(tmp_path):
    store = Store(tmp_path)
    with store.workspace("row/c", {"seed": 2}):
        pass
    with pytest.raises(StoreError, match="row/c"):
        count_units(tmp_path, {"row/c": 1.0}, {"row/c": {"seed": 3}})


def test_an_unknown_study_or_scale_names_the_nearest():
    with pytest.raises(StudyError, match="did you mean 'horizon'"):
        find_study("horizont")
    with pytest.raises(StudyError, match="did you mean 'smoke'"):
        find_study("horizon").folder("smok")


def test_results_that_are_not_there_are_an_error(tmp_path):
    with pytest.raises(StudyError, match="there are no results of the study horizon in"):
        check_results(find_study("horizon"), tmp_path / "none")
    with pytest.raises(StudyError, match="there are no results of the study placement"):
        check_results(find_study("placement"), tmp_path)


@pytest.mark.parametrize("name", ["horizon", "placement"])
def test_a_page_that_is_not_of_the_study_is_not_touched(tmp_path, name):
    study = find_study(name)
    check_page(study, tmp_path)
    (tmp_path / "README.md").write_text("mine")
    with pytest.raises(StudyError, match=f"is not a page of the study {name}; move it"):
        check_page(study, tmp_path)


@pytest.mark.parametrize("folder", ["horizon", "horizon-replication", "placement"])
def test_the_pages_of_this_repository_have_the_mark(folder):
    study, results = find_study(folder.partition("-")[0]), Path(__file__).parents[2] / "results" / folder
    check_results(study, results)
    check_page(study, results)
