"""`cure`: a policy's verdict, further training that may make it hold, the verdict again, and whether that helped.

Each part is a stored run: the evaluation keeps its episodes, the training its checkpoints, and a cure that was
interrupted continues. Both policies meet the same start states and the same draws of the disturbances.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from perdure.envs import module_of, refuse_import, task_of_environment
from perdure.errors import PerdureError, did_you_mean, lookup
from perdure.evaluate.compare import By
from perdure.evaluate.options import Extrapolation
from perdure.evaluate.run import file_subjects
from perdure.evaluate.stored import REPLACED, open_evaluator
from perdure.evaluate.table import TABLE_FILE, ExtrapolationResult, file_note, made_with, train_seed
from perdure.evaluate.units import Execution
from perdure.learn.recipe import Recipe
from perdure.learn.run import TrainRun, kept_steps, train
from perdure.policy import load_policy
from perdure.policy.readers.found import policy_file
from perdure.report.comparison import BETTER, MEASURES, PolicyKey, Ranked, compare_policies, rank_policies
from perdure.report.cure_page import CURED, Cured, next_steps, text, write_page
from perdure.report.estimates import Estimate, estimate_table
from perdure.report.lead import Step
from perdure.report.outcomes import NeverWorked
from perdure.report.schema import FILE_NOTE, IMPORTED
from perdure.runs import Observer, file_digest, write_atomic
from perdure.runs.progress import Lines
from perdure.schema import Parquet

if TYPE_CHECKING:
    import polars as pl

TRAINING = "training"
"""Folder of the further training in the folder of the results."""
READING = ("normalizer", "trust", "training_horizon")
"""Options of `perdure.policy.readers.import_sb3` that a cure takes for a model."""
PLACES = ("cores", "on", "command")
"""Options of `Execution` that a cure takes."""
Progress = Callable[[str, str], AbstractContextManager[Observer]]
"""Given a title and the name of what is counted: a block that shows the progress of a part."""


@dataclass(frozen=True, kw_only=True)
class Cure:
    """What a cure is asked for. Each field is an option of `perdure.cure` and a flag of `perdure cure`.

    Raises:
        PerdureError: `by` is unknown.
    """

    env: str | None = None
    """For models: the environment they were trained in. Hopper-v5 is Gymnasium's if Gymnasium can make it;
    envpool:Hopper-v5 is EnvPool's, which is faster. A policy file names its own."""
    steps: int = Recipe.total_steps
    """Environment steps of the further training."""
    seeds: tuple[int, ...] = (0,)
    """Training seeds. With several, the best one is chosen on the first start states and judged on others."""
    disturb: tuple[str, ...] = Recipe.disturb
    """What disturbs every training episode, all together, such as action_noise:0.1 or standard-1 (see `perdure list
    disturbances`). The verdicts are always calm and under standard-1."""
    by: By = "work"
    """What decides whether it helped: work (return above idle, as a share of what the better policy earns when calm),
    holds (share of the episodes that hold), or hours (time before a failure)."""
    require: Literal["holds", "better"] | None = None
    """End with exit code 3 unless the policy holds at the end (holds), or it is shown that the cure helped (better)."""
    modules: tuple[str, ...] = ()
    """Python modules that the policy's task may import; a policy file alone never imports anything."""

    def __post_init__(self) -> None:
        lookup(MEASURES, self.by, "measure (by)")


@dataclass(frozen=True, eq=False)
class CureResult:
    """What a cure did. As text: one line of before and after, both verdicts, and the comparison."""

    cured: Cured
    """Verdicts of both, and their comparison."""
    asked: Cure
    evaluation: ExtrapolationResult
    """The table of all episodes of both policies."""
    start: Path
    """File of the policy that was trained further."""
    policy: Path | None = None
    """File of the cured policy; None where the policy held already."""
    page: Path | None = None
    """The page of the results."""
    training_seconds: float = 0.0
    """How long this call trained; about 0 if that was finished before."""
    seconds: float = 0.0
    """How long this call took."""

    def __str__(self) -> str:
        return text(self.cured)

    @property
    def verdict(self) -> str:
        """Whether the cured policy is "better" or "worse"; "cannot tell"; "held already"."""
        return self.cured.verdict

    @property
    def helped(self) -> bool:
        """Whether it is shown that the cured policy is better."""
        return self.verdict == BETTER

    @property
    def holds(self) -> bool:
        """Whether the policy holds at the end, calm and disturbed."""
        return self.cured.holds

    @property
    def met(self) -> bool:
        """Whether what is required is shown; True if nothing is."""
        if self.asked.require == "holds":
            return self.holds
        return self.asked.require is None or self.helped


@contextmanager
def _lines(title: str, measure: str) -> Iterator[Observer]:
    lines = Lines(title, measure)
    yield lines
    lines.close()


def cure(
    policy: str | Path,
    env: str | None = None,
    options: Cure | None = None,
    *,
    out: str | Path = "cure",
    evaluation: Extrapolation | None = None,
    progress: Progress = _lines,
    tell: Callable[[str], None] = lambda sentence: None,
    **settings: Any,
) -> CureResult:
    """Train a policy further so that it holds, and say whether that helped.

    The policy is judged, calm and under `standard-1`; continued by the recipe of `perdure.learn.recipe`; judged on the
    same start states and draws; and compared. An interrupted cure continues when it is called again.

    Args:
        policy: A policy file, the name of a shipped policy, a model of Stable-Baselines3 whose actions do not go
            through tanh (PPO, A2C, TRPO), a run of RL Baselines3 Zoo, or an ONNX model that is a plain network.
        env: The environment of a model; a policy file names its own.
        options: The options as an object.
        out: Folder of the results: the page `cure.html`, the table, the cured policy, and all that is kept.
        evaluation: What both are judged by, in place of `perdure.extrapolate`'s defaults.
        progress: Shows the progress of each part; by default a line on standard error every half minute.
        tell: Gets a sentence on what is read.
        settings: The fields of `Cure`, also in place of those of ``options``; ``cores``, ``on`` and ``command`` of
            `Execution`; ``normalizer``, ``trust`` and ``training_horizon`` of `perdure.policy.readers.import_sb3`.

    Raises:
        PerdureError: There is no such policy or environment, training cannot continue the policy, it never worked,
            ``out`` holds another evaluation, or a part failed.
    """
    began = time.monotonic()
    if env is not None:
        settings["env"] = env
    asked, reading, where = _read_settings(options or Cure(), settings)
    folder = Path(out)
    start, run = _further_training(policy, asked, reading, folder, tell)
    judging = evaluation or Extrapolation()
    judging = replace(judging, modules=(*judging.modules, *asked.modules))
    execution = Execution(out=folder, **where)
    with progress(f"{run.task} before", "steps") as observe:
        before, (key,) = _judge([start], judging, replace(execution, observe=observe))
    cured = Cured(run.task, _of(before.frame, key))
    _check_worked(cured.before, before.frame, key, asked.by)
    result = CureResult(cured, asked, before, start)
    if not _never_fails(cured.before):
        result = _treat(result, run, judging, execution, progress)
    given = {"env": asked.env, **{name.replace("_", "-"): value for name, value in reading.items()}}
    named = {name: value for name, value in given.items() if value not in (None, False)}
    following = next_steps(result.cured, str(policy), named, asked.steps, folder)
    page = _write(result, following, folder, execution.command)
    return replace(result, page=page, seconds=time.monotonic() - began)


def _treat(
    result: CureResult, run: TrainRun, judging: Extrapolation, execution: Execution, progress: Progress
) -> CureResult:
    """Train the policy further, judge it again and compare.

    Args:
        result: Of the policy before.
        run: The further training.
        judging: What policies are judged by.
        execution: Where, with the folder of the results.
        progress: As of `cure`.
    """
    folder = Path(execution.out or "")
    asked = result.asked
    # Train.
    began = time.monotonic()
    with progress(f"{run.task} cure", "steps") as observe:
        files = train(run, folder / TRAINING, cores=execution.cores, on=execution.on, observe=observe)
    training = time.monotonic() - began
    # Judge again. Of several, the best is chosen and judged where it was not chosen.
    file = files[0]
    selection = ""
    with progress(f"{run.task} after", "steps") as observe:
        watched = replace(execution, observe=observe)
        after, keys = _judge([result.start, *files], judging, watched)
        if len(files) > 1:
            order, ranked = rank_policies(after.frame, keys[1:], asked.by)
            file = files[keys[1:].index(order[0])]
            fresh = int(after.frame["eval_seed"].max()) + 1  # type: ignore[arg-type]
            selection = _selection(order, ranked, fresh)
            after, keys = _judge([result.start, file], replace(judging, first_eval_seed=fresh), watched)
    # Compare.
    summary = compare_policies(after.frame, keys[0], keys[1], asked.by)
    before = _of(after.frame, keys[0])
    cured = Cured(run.task, before, _of(after.frame, keys[1]), summary, selection)
    kept = write_atomic(folder / CURED, file.read_bytes())
    return replace(result, cured=cured, evaluation=after, policy=kept, training_seconds=training)


def _read_settings(options: Cure, settings: Mapping[str, Any]) -> tuple[Cure, dict[str, Any], dict[str, Any]]:
    """Return the options of a cure, of reading a model, and of where it runs: keywords over the options."""
    known = {each.name for each in fields(Cure)}
    allowed = {*known, *READING, *PLACES}
    for name in settings:
        if name not in allowed:
            hint = did_you_mean(name, allowed)
            raise PerdureError(f"cure has no option {name!r}; it has {', '.join(sorted(allowed))}{hint}")
    changes = {name: value for name, value in settings.items() if name in known}
    for name in ("disturb", "modules"):
        if isinstance(changes.get(name), str):
            changes[name] = (changes[name],)
    asked = replace(options, **changes)
    if asked.env is not None:
        named = module_of(task_of_environment(asked.env))
        if named is not None:
            asked = replace(asked, modules=(*asked.modules, named))
    reading = {name: value for name, value in settings.items() if name in READING}
    return asked, reading, {name: value for name, value in settings.items() if name in PLACES}


def _further_training(
    policy: str | Path, asked: Cure, reading: dict[str, Any], folder: Path, tell: Callable[[str], None]
) -> tuple[Path, TrainRun]:
    """Return the file of the policy and its further training; refuse what cannot be continued, or not here.

    Args:
        policy: As of `cure`.
        asked: The options.
        reading: How a model of another library is read.
        folder: Of the results.
        tell: Gets a sentence on what is read.
    """
    start = policy_file(policy, folder / IMPORTED, asked.env, reading, asked.modules, tell)
    task = load_policy(start).task.name
    if asked.env is not None and task_of_environment(asked.env) != task:
        raise PerdureError(f"{policy} is for {task}, not for {asked.env}: a policy file names its own environment")
    refuse_import(task, asked.modules, str(policy))
    _refuse_other(folder, start)
    recipe = Recipe(total_steps=asked.steps, disturb=asked.disturb)
    run = recipe.run(start, task, seeds=asked.seeds)
    kept_steps(run, folder / TRAINING)  # refuses a folder that holds another training
    return start, run


def _refuse_other(folder: Path, start: Path) -> None:
    """Refuse to replace the table of an evaluation of other policies."""
    path = folder / TABLE_FILE
    if not path.exists():
        return
    notes = Parquet(path.read_bytes()).notes
    if file_digest(start) not in [value for name, value in notes.items() if name.startswith(FILE_NOTE)]:
        raise PerdureError(REPLACED.format(folder))


def _judge(
    files: Sequence[Path], judging: Extrapolation, execution: Execution
) -> tuple[ExtrapolationResult, list[PolicyKey]]:
    """Run the episodes of policies that the folder lacks; return their table, and what it calls each policy."""
    subjects, worlds = file_subjects(files, None, judging)
    with open_evaluator(subjects, worlds, judging, execution) as evaluator:
        frame, baselines = evaluator.judged(evaluator.conditions)
    keys = [(each.label, train_seed(each.policy)) for each in subjects]
    notes = {file_note(*key): each.digest for key, each in zip(keys, subjects, strict=True) if each.digest}
    return ExtrapolationResult(frame, None, notes, baselines, judging.success or ""), keys


def _of(frame: pl.DataFrame, key: PolicyKey) -> list[Estimate]:
    """Return the estimates of one policy of a table of one task, one for each condition."""
    import polars as pl

    mine = (pl.col("policy") == key[0]) & (pl.col("train_seed") == key[1])
    (found,) = estimate_table(frame.filter(mine)).values()
    return found


def _check_worked(before: Sequence[Estimate], frame: pl.DataFrame, key: PolicyKey, by: str) -> None:
    """Refuse a policy that never worked, and a measure that says nothing here, before anything is trained."""
    if all({*item.group.verdicts} == {NeverWorked.name} for item in before):
        raise PerdureError(
            f"{key[0]} never worked: within its training horizon it gains little over an idle robot. A cure lengthens "
            "the horizon of a policy that works: check how it is read (--env, --normalizer), or train it first"
        )
    compare_policies(frame, key, key, by)


def _never_fails(before: Sequence[Estimate]) -> bool:
    """Return whether every episode holds, so that there is nothing to cure."""
    return all(item.verdict.good and float(item.verdict.share.estimate) == 1.0 for item in before)


def _selection(order: Sequence[PolicyKey], ranked: Sequence[Ranked], fresh: int) -> str:
    """Return how the best of several training seeds was chosen, and where the numbers are from."""
    others = ", ".join(
        f"seed {key[1]} {float(each.value.estimate):.2f}" for key, each in zip(order, ranked, strict=True)
    )
    return (
        f"Training seed {order[0][1]} is the first of {len(order)} by the mean of what decides ({others}). The best of "
        f"several is partly lucky, so all other numbers are from start states {fresh} and later, which chose nothing."
    )


def _write(result: CureResult, following: Sequence[Step], folder: Path, command: str) -> Path:
    """Write the table and the page into the folder of the results; return the page."""
    result.evaluation.write_table(folder, command)
    made = made_with()
    made_words = f"Evaluated on {made['evaluated']}. With {made['versions']}"
    return write_page(result.cured, following, folder, command, made_words)
