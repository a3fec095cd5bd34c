"""`compare` and `rank`: which of two policies is better, which of two methods, which of many policies.

Both sides run from the same start states, with the same draws of the disturbances. Two policies get more start states
until the difference is decided; the test stays valid although one looks after every batch (`perdure.sequential`).
Several training runs a side, and policies that are ranked, get a fixed number of start states.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from perdure.disturbances import CALM
from perdure.envs import open_env, refuse_import, report_success
from perdure.errors import PerdureError, lookup
from perdure.evaluate.early import FIRST_SEEDS
from perdure.evaluate.options import DISTURBED_SEEDS, DISTURBED_STEPS, Condition, Extrapolation
from perdure.evaluate.run import file_subjects, load, read_options, subject_here
from perdure.evaluate.stored import Evaluator, open_evaluator
from perdure.evaluate.table import file_note, made_with, train_seed
from perdure.evaluate.units import Execution, Subject, Worlds
from perdure.policy import Policy, find_policies
from perdure.policy.onnx import is_onnx
from perdure.report import write_table
from perdure.report.comparison import (
    BETTER,
    CANNOT_TELL,
    MEASURES,
    WORSE,
    PolicyKey,
    Ranking,
    Summary,
    compare_methods,
    compare_policies,
    measures_frame,
    rank_policies,
)
from perdure.report.comparison_page import ranking_text, summary_text, write_page

if TYPE_CHECKING:
    import polars as pl

CALM_SEEDS = 8
"""Calm start states of a comparison under a disturbance. Calm episodes of one policy hardly differ."""
TABLE = "comparison.parquet"
"""Name of the table of a comparison, beside those of evaluations in the same folder."""
By = Literal["work", "holds", "hours"]


@dataclass(frozen=True)
class Comparison(Extrapolation):
    """What a comparison is asked for: the options of an evaluation, with others' defaults, and what decides.

    Raises:
        PerdureError: As `Extrapolation`; `by` is unknown, or several conditions or clocks would decide.
    """

    steps: int | None = None
    """Steps of each episode, calm and disturbed (10,000 by default)."""
    clocks: tuple[str, ...] = Extrapolation.clocks
    """One clock for policies with a time-to-go input: {clocks}, countdown (to the end), or default (each policy's
    own)."""
    eval_seeds: int | None = None
    """Start states of each training run, or of each policy that is ranked (36)."""
    disturb: tuple[str, ...] | None = field(default=None, kw_only=True)
    """none (calm episodes decide), standard-1 (used if left out), or what disturbs every episode, all together:
    {disturbances}."""
    by: By = field(default="work", kw_only=True)
    """What decides: work (return above idle, as a share of what the better policy earns when calm), holds (share of the
    episodes that hold), or hours (time before a failure). Choose it before you see results."""
    most: int = field(default=200, kw_only=True)
    """Most start states of two policies: the comparison ends there if it is not decided."""
    margin: float = field(default=0.05, kw_only=True)
    """How much worse counts as not worse, for --require not-worse: of work, or of the share that `by` names."""
    require: Literal["better", "not-worse"] | None = field(default=None, kw_only=True)
    """End with exit code 3 unless it is shown that B is better, or that B is not worse by more than --margin; two
    policies get start states until that is decided."""

    def __post_init__(self) -> None:
        super().__post_init__()
        lookup(MEASURES, self.by, "measure (by)")
        if not (isinstance(self.most, int) and self.most >= 1):
            raise PerdureError(f"most must be a whole number of start states, at least 1, got {self.most!r}")
        if not 0.0 <= self.margin <= 1.0:
            raise PerdureError(f"margin must be between 0 and 1, got {self.margin!r}")
        if len(self.clocks) > 1:
            raise PerdureError(f"a comparison has one clock, got {', '.join(self.clocks)}")
        disturbed = [label for label, disturbances in self._disturbances.items() if disturbances]
        if len(disturbed) > 1:
            raise PerdureError(f"one condition decides, got {', '.join(disturbed)}: name one level")

    def _asked(self, step_seconds: float) -> list[Condition]:
        """Return calm episodes and the disturbed ones; the last condition decides."""
        steps = self._steps(step_seconds) or DISTURBED_STEPS
        asked = [Condition(CALM, (), steps, CALM_SEEDS)]
        for label, disturbances in self._disturbances.items():
            if disturbances:
                asked.append(Condition(label, disturbances, steps, self.most))
        return asked


@dataclass(frozen=True, eq=False)
class ComparisonResult:
    """Which of two policies, or of two methods, is better. As text: the answer and its numbers."""

    summary: Summary
    frame: pl.DataFrame
    """The table of all episodes, as `ExtrapolationResult.frame`."""
    asked: Comparison
    path: Path | None = None
    """The Parquet file of the table; None where nothing was written."""

    def __str__(self) -> str:
        return summary_text(self.summary)

    @property
    def verdict(self) -> str:
        """Whether B is "better" or "worse" than A; else "cannot tell"."""
        return self.summary.verdict

    @property
    def more(self) -> float:
        """About how many more start states, or training runs a side, would decide; 0 if it is decided."""
        return self.summary.more

    @property
    def not_worse(self) -> bool:
        """Whether B is better, or worse by less than the margin."""
        return self.verdict != WORSE and self.summary.deciding.difference.last()[0] > -self.asked.margin

    @property
    def met(self) -> bool:
        """Whether what is required is shown; True if nothing is."""
        if self.asked.require == "better":
            return self.verdict == BETTER
        return self.asked.require is None or self.not_worse

    @property
    def measures(self) -> pl.DataFrame:
        """One row for each condition and measure: estimate, low and high of A, of B and of B - A."""
        return measures_frame(self.summary)


@dataclass(frozen=True, eq=False)
class RankingResult:
    """Policies by one measure, and the first one confirmed. As text: the ranking."""

    ranking: Ranking
    frame: pl.DataFrame
    """The table of all episodes; the last start states are those of the confirmation."""
    path: Path | None = None
    """The Parquet file of the table; None where nothing was written."""

    def __str__(self) -> str:
        return ranking_text(self.ranking)


Side = Any
"""A function, a `Policy`, a file, the name of a shipped policy, a folder of files, or a sequence of these."""


def compare(
    a: Side, b: Side, env: Any = None, comparison: Comparison | None = None, **options: Any
) -> ComparisonResult:
    """Return whether B is better than A.

    Two policies run from the same start states until it is decided. Two methods, each given as several training runs,
    are compared over runs. Files leave their episodes in ``out``, as those of `perdure.extrapolate` do, and resume.

    Args:
        a: The baseline: a function of observations, a `Policy`, a policy file, the name of a shipped policy; for a
            method a folder of files or a list.
        b: What is compared with it.
        env: As of `perdure.extrapolate`; needed for functions and ONNX models.
        comparison: The options as an object.
        options: The fields of `Comparison`, also in place of those of ``comparison``, and of `Execution`.

    Raises:
        PerdureError: As `perdure.extrapolate`; one side is a policy and the other a method; the measure says nothing in
            this task.
    """
    asked, execution = read_options(comparison or Comparison(), options, "compare")
    sides = [_side(a), _side(b)]
    sizes = [len(each) for each in sides]
    if min(sizes) == 1 < max(sizes):
        raise PerdureError(
            f"A has {sizes[0]} and B {sizes[1]} policies: compare one policy with one, or several training runs of one "
            "method with several of another"
        )
    with _opened([*sides[0], *sides[1]], env, asked) as (subjects, worlds), _kept(execution) as where:
        with open_evaluator(subjects, worlds, asked, where) as evaluator:
            keys = [_key(each) for each in subjects]
            if len(subjects) == 2:
                frame, summary = _until_decided(evaluator, asked, keys[0], keys[1])
            else:
                names = (_name(a, subjects[: sizes[0]]), _name(b, subjects[sizes[0] :]))
                frame, _ = evaluator.judged(_with_seeds(evaluator.conditions, asked.eval_seeds or DISTURBED_SEEDS))
                summary = compare_methods(frame, keys[: sizes[0]], keys[sizes[0] :], asked.by, names)
        path = _write(frame, subjects, summary, execution)
        return ComparisonResult(summary, frame, asked, path)


def rank(
    policies: Sequence[Side] | Side, env: Any = None, comparison: Comparison | None = None, **options: Any
) -> RankingResult:
    """Rank policies, such as checkpoints or training runs, and confirm the best one on fresh start states.

    Args:
        policies: A folder of files, or a sequence of what `compare` takes; at least two.
        env: As of `compare`, as for the other arguments.
        comparison: The options as an object.
        options: Likewise.

    Raises:
        PerdureError: As `compare`; there is only one policy.
    """
    asked, execution = read_options(comparison or Comparison(), options, "rank")
    named = _side(policies)
    if len(named) < 2:
        raise PerdureError(f"{policies} holds one policy: name a second one to compare it with")
    seeds = asked.eval_seeds or DISTURBED_SEEDS
    with _opened(named, env, asked) as (subjects, worlds), _kept(execution) as where:
        keys = [_key(each) for each in subjects]
        with open_evaluator(subjects, worlds, asked, where) as evaluator:
            frame, _ = evaluator.judged(_with_seeds(evaluator.conditions, seeds))
        order, ranked = rank_policies(frame, keys, asked.by)
        # The winner was selected: its number is too high. It meets the second again, on other start states.
        fresh = replace(asked, first_eval_seed=asked.first_eval_seed + max(seeds, CALM_SEEDS))
        finalists = [subjects[keys.index(key)] for key in (order[1], order[0])]
        with open_evaluator(finalists, worlds, fresh, where) as evaluator:
            again, confirmed = _until_decided(evaluator, fresh, order[1], order[0])
    ranking = Ranking(confirmed.task, asked.by, confirmed.condition, seeds, ranked, confirmed)
    frame = frame.vstack(again.filter(again["eval_seed"] >= fresh.first_eval_seed))
    return RankingResult(ranking, frame, _write(frame, subjects, ranking, execution))


def _until_decided(evaluator: Evaluator, asked: Comparison, a: PolicyKey, b: PolicyKey) -> tuple[pl.DataFrame, Summary]:
    """Add start states until it is decided whether B is better; return the table and the answer."""
    count = min(FIRST_SEEDS, asked.most)
    while True:
        frame, _ = evaluator.judged(_with_seeds(evaluator.conditions, count))
        summary = compare_policies(frame, a, b, asked.by)
        result = ComparisonResult(summary, frame, asked)
        decided = result.verdict != CANNOT_TELL
        if asked.require == "not-worse":
            decided = result.not_worse or result.verdict == WORSE
        if decided or count == asked.most:
            return frame, summary
        count = min(asked.most, count + max(1, count // 2))  # few looks, since each one starts processes


def _with_seeds(conditions: Sequence[Condition], count: int) -> list[Condition]:
    """Return the conditions with so many start states for the last one, which decides; at most so many for others."""
    *others, deciding = conditions
    fixed = [replace(each, eval_seeds=min(each.eval_seeds, CALM_SEEDS)) for each in others]
    return [*fixed, replace(deciding, eval_seeds=count)]


# Sides


def _side(given: Side) -> list[Any]:
    """Return the policies that a side names."""
    if isinstance(given, str | Path):
        if is_onnx(given):
            return [Path(given)]
        return list(find_policies(given))
    if isinstance(given, Sequence):
        return [each for part in given for each in _side(part)]
    return [given]


def _key(subject: Subject) -> PolicyKey:
    return subject.label, train_seed(subject.policy)


def _name(given: Side, subjects: Sequence[Subject]) -> str:
    """Return the name of a method: the label that its runs share, else what the caller named."""
    labels = {each.label for each in subjects}
    if len(labels) == 1:
        return labels.pop()
    if isinstance(given, str | Path):
        return Path(given).name
    if all(isinstance(each, str | Path) for each in given):
        return Path(os.path.commonpath(given)).name
    return f"{len(subjects)} policies"


@contextmanager
def _opened(policies: Sequence[Any], env: Any, asked: Comparison) -> Iterator[tuple[list[Subject], Worlds]]:
    """Yield policies as the evaluator takes them, and where they act.

    Policy files, and ONNX models with the name of an environment, run over the cores; everything else in this process.
    """
    if env is None:
        env = asked.env
    of_files = all(isinstance(each, Path) for each in policies)
    models = of_files and any(is_onnx(each) for each in policies)
    if of_files and (env is None or (isinstance(env, str) and models)):
        yield file_subjects(policies, env, asked)
        return
    loaded = [load(each) if isinstance(each, Path) else each for each in policies]
    if env is None:
        tasks = [each.task.name for each in loaded if isinstance(each, Policy)]
        if not tasks:
            raise PerdureError("env (--env) is missing: name the task, or give a factory or a VectorEnv")
        refuse_import(tasks[0], asked.modules, "the policy")
        env = tasks[0]
    with open_env(env) as opened:
        source = replace(opened, make=lambda seeds: report_success(opened.make(seeds), asked.success))
        subjects = _distinct([subject_here(each, source, asked, False, None) for each in loaded])
        task = subjects[0].policy.task.name
        yield subjects, Worlds(task, None if isinstance(env, str) else source, asked.success)


def _distinct(subjects: Sequence[Subject]) -> list[Subject]:
    """Return policies of this process with an identity and a name each: functions have none of their own."""
    found = []
    keys = [_key(each) for each in subjects]
    for number, subject in enumerate(subjects):
        label = subject.label
        if keys.count(keys[number]) > 1:
            label = f"{label} {number + 1}"
        source = replace(subject.source, identity=f"{subject.source.identity} {number}")
        found.append(replace(subject, label=label, source=source))
    return found


# Results


def _kept(execution: Execution) -> Any:
    """Return a block in which episodes are kept: in the folder of the results, or until the block ends."""
    if execution.out is not None:
        return nullcontext(execution)
    return _temporary(execution)


@contextmanager
def _temporary(execution: Execution) -> Iterator[Execution]:
    with tempfile.TemporaryDirectory() as folder:
        yield replace(execution, out=folder)


def _write(
    frame: pl.DataFrame, subjects: Sequence[Subject], result: Summary | Ranking, execution: Execution
) -> Path | None:
    """Write table and page into the folder of the results; return the table's path, None without a folder."""
    if execution.out is None:
        return None
    made = made_with()
    files: Mapping[str, str] = {
        file_note(each.label, train_seed(each.policy)): each.digest for each in subjects if each.digest
    }
    write_page(result, execution.out, execution.command, f"Evaluated on {made['evaluated']}. With {made['versions']}")
    return write_table(Path(execution.out) / TABLE, frame, {"command": execution.command, **made, **files})
