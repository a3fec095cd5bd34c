"""Steps are carried out in order; what fails stops only what depends on it; status and cost are read from stores."""

from dataclasses import dataclass, field

import pytest

from perdure.runs import RunError
from perdure.studies import RunOptions, StepProgress, StudyError, find_study
from perdure.studies.run import read_folder, run_steps
from perdure.studies.status import cost_text, failed_steps, lines, read_step_progress, status_text


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


def test_an_unknown_study_or_scale_names_the_nearest():
    with pytest.raises(StudyError, match="did you mean 'horizon'"):
        find_study("horizont")
    with pytest.raises(StudyError, match="did you mean 'smoke'"):
        find_study("horizon").check_scale("smok")


def test_results_that_are_not_there_are_an_error(tmp_path):
    with pytest.raises(StudyError, match="there are no results in"):
        read_folder(tmp_path / "none")
