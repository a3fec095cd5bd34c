"""The evaluator: runs the episodes of conditions as units of work, judges them, and writes their table into a folder.

Groups of episodes of policy files are kept in the folder and used again; those of others until the evaluation ends.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from perdure.errors import PerdureError
from perdure.evaluate.early import find_stop, parts
from perdure.evaluate.episodes import EpisodeSpec
from perdure.evaluate.judge import Baselines, judge_table, make_scales
from perdure.evaluate.options import Condition, Extrapolation
from perdure.evaluate.table import TABLE_FILE, ExtrapolationResult, file_note, train_seed, with_not_applied
from perdure.evaluate.units import GROUPS, Execution, Groups, Subject, Worlds, clock_label
from perdure.policy import check_fit
from perdure.report.schema import EarlyStop
from perdure.runs import Store
from perdure.schema import Parquet

if TYPE_CHECKING:
    import polars as pl

REPLACED = "{} holds another evaluation, which would be replaced: name another folder with --out (out=), or remove it"


def evaluate(
    subjects: Sequence[Subject], worlds: Worlds, evaluation: Extrapolation, execution: Execution
) -> ExtrapolationResult:
    """Evaluate every episode, and write ``episodes.parquet`` into the folder of the results.

    Args:
        subjects: All of files, which other processes can read, or all of this process.
        worlds: Where they act.
        evaluation: Which episodes there are.
        execution: Where they run.

    Raises:
        PerdureError: If a policy does not fit the environment, the folder holds another evaluation, or a group of
            episodes failed.
        OSError: If the folder cannot be written.
    """
    with open_evaluator(subjects, worlds, evaluation, execution) as evaluator:
        conditions = evaluator.conditions
        if execution.out is not None:
            episodes = evaluator.episodes(conditions)
            _refuse_replacing(Store(execution.out), subjects, episodes, evaluation.success or "")
        frame, baselines, stopped = _judged_table(evaluator, execution.stop_early)
        files = {file_note(each.label, train_seed(each.policy)): each.digest for each in subjects if each.digest}
        result = ExtrapolationResult(frame, None, files, baselines, evaluation.success or "", stopped)
        if execution.out is None:
            return result
        if evaluator.of_files:  # the command line writes their page, with stills
            path, _ = result.write_table(execution.out, execution.command)
        else:
            result.write(execution.out, execution.command)
            path = Path(execution.out) / TABLE_FILE
        return replace(result, path=path)


def _judged_table(evaluator: Evaluator, stop_early: bool) -> tuple[pl.DataFrame, Baselines, EarlyStop | None]:
    """Return the judged table, the baselines of its policies, and why it lacks episodes; None if it has all."""
    conditions = evaluator.conditions
    if stop_early:
        for part in parts(conditions):
            frame, baselines = evaluator.judged(part)
            stopped = find_stop(frame, part, conditions, len(evaluator.episodes(conditions)))
            if stopped is not None:
                return frame, baselines, stopped
    frame, baselines = evaluator.judged(conditions)
    return frame, baselines, None


@dataclass(frozen=True)
class Evaluator:
    """Runs and judges the episodes of conditions, one set of conditions after another; see `open_evaluator`."""

    subjects: Sequence[Subject]
    worlds: Worlds
    evaluation: Extrapolation
    execution: Execution
    store: Store
    """Keeps the episodes that are finished: none of them runs twice."""
    of_files: bool
    """All policies are of files, which other processes can read."""
    conditions: Sequence[Condition]
    """Those that the evaluation names, as far as the environment can do them."""
    engine: str
    """Of the environment, see `TaskSpec.engine`."""

    def episodes(self, conditions: Sequence[Condition]) -> list[EpisodeSpec]:
        """Return the episodes of these conditions."""
        return self.evaluation.episodes([each.policy for each in self.subjects], conditions)

    def judged(self, conditions: Sequence[Condition]) -> tuple[pl.DataFrame, Baselines]:
        """Run what the store lacks of these conditions; return their judged table and the baselines of its policies.

        Raises:
            PerdureError: A group of episodes failed.
        """
        groups = Groups(self.subjects, self.worlds, self.store, self.episodes(conditions))
        groups.run(self.evaluation.max_episodes, self.execution, keep_going=self.of_files)
        # The table: raw columns of all episodes, then the verdicts.
        raw = with_not_applied(groups.table(), conditions)
        baselines = groups.baselines(self.engine)
        return judge_table(raw, make_scales(baselines, self.subjects[0].policy.task.name)), baselines


@contextmanager
def open_evaluator(
    subjects: Sequence[Subject], worlds: Worlds, evaluation: Extrapolation, execution: Execution
) -> Iterator[Evaluator]:
    """Yield what runs the episodes of an evaluation; one at a time works in a folder of results.

    Arguments and errors are those of `evaluate`.
    """
    of_files = all(each.digest is not None for each in subjects)
    # Which episodes there are depends on what the environment can do.
    with closing(worlds.first()) as world:
        for each in subjects:
            check_fit(each.policy, world)
        spec = world.spec
    conditions = evaluation.conditions(spec, worlds.first)
    with ExitStack() as stack:
        # One evaluation at a time writes into a folder. Groups of policies without a file are kept elsewhere.
        if execution.out is not None:
            store = Store(execution.out)
            stack.enter_context(store.exclusive("extrapolate", execution.waiting))
        if execution.out is None or not of_files:
            store = Store(stack.enter_context(tempfile.TemporaryDirectory()))
        if not of_files:
            execution = replace(execution, on="here", cores=1)
        yield Evaluator(subjects, worlds, evaluation, execution, store, of_files, conditions, spec.engine)


def _refuse_replacing(store: Store, subjects: Sequence[Subject], episodes: Sequence[EpisodeSpec], success: str) -> None:
    """Refuse to replace a table that has episodes of other files or settings than those asked for."""
    path = store.root / TABLE_FILE
    if any(each.digest is None for each in subjects):
        if path.exists() or store.keys(GROUPS):
            raise PerdureError(f"an evaluation in this process cannot be continued: {REPLACED.format(store.root)}")
        return
    if not path.exists():
        return
    asked = set[tuple[Any, ...]]()
    for each in episodes:
        subject = subjects[each.policy]
        horizon = float(subject.policy.training_horizon)
        settings = (horizon, each.steps, clock_label(each), each.eval_seed, each.disturbance)
        asked.add((subject.digest, success, subject.policy.task.name, *settings))
    columns = ("policy", "train_seed", "task", "train_horizon", "test_horizon", "clock", "eval_seed", "disturbance")
    kept = set[tuple[Any, ...]]()
    try:
        table = Parquet(path.read_bytes())
        for policy, seed, *settings_kept in table.read(columns).unique().iter_rows():
            digest = table.notes.get(file_note(policy, seed))
            kept.add((digest, table.notes.get("success", ""), *settings_kept))
    except PerdureError:  # of another version, or damaged
        kept = {()}
    if not kept <= asked:
        raise PerdureError(REPLACED.format(store.root))
