"""The commands ``extrapolate`` and ``report``: evaluate policies, write the report, and show what came out."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from perdure.cli.parse import Cores, Normalizer, On, TimeFeature, Trust, call, whole_command
from perdure.cli.subjects import is_function, load_function, named_files, policy_files, tell
from perdure.errors import PerdureError
from perdure.evaluate import Extrapolation, ExtrapolationResult
from perdure.evaluate.options import OWN_CLOCK
from perdure.report.charts import Format
from perdure.report.outcomes import NeverWorked

NOT_HOLDING = 3
"""Exit code of `--require` if something does not hold."""


def main(name: str, args: list[str]) -> None:
    """Run a command of this module."""
    if name == "report":
        call(report, args, name)
    else:
        extrapolate_words(args)


def extrapolate_words(args: list[str]) -> None:
    """Run ``perdure extrapolate`` with these arguments."""
    extrapolate(call(Flags, args, "extrapolate"), whole_command(args, "extrapolate"))


@dataclass(frozen=True, kw_only=True)
class Flags(Extrapolation):
    """Run policies far beyond their training horizon, under several clocks, and judge them.

    An episode is one deployed run: a policy under a clock from a start state. By default there are 3 calm ones of
    100,000 steps and 36 of 10,000 steps under standard-1, small disturbances. Writes episodes.parquet,
    report.html and figures. An interrupted command resumes when you run it again.
    """

    policies: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[[STR [STR ...]]]")] = ()
    """Policy files, names of shipped policies (`perdure list policies`), model.onnx, rsl_rl's model_1.pt, model.zip of
    Stable-Baselines3, a folder of its checkpoints, a run of RL Baselines3 Zoo (logs/ppo/Hopper-v4_1); all for one task.
    Or a Python function (my_policies:walk): imported from the working directory or PYTHONPATH, run in this process."""
    normalizer: Normalizer = None
    time_feature: TimeFeature = None
    trust: Trust = False
    out: Path = Path("extrapolation")
    """Folder for the table and the report. Finished parts of an interrupted evaluation are kept there."""
    cores: Cores = None
    on: On = "local"
    require: Literal["holds", "clean"] | None = None
    """End with exit code 3, and a line that names them, if policies do not hold under every clock and disturbance
    (holds), or hold with a caveat (clean). It ends early, once it is certain that something does not hold."""
    json: bool = False
    """Print the summary as one JSON document, and nothing else on standard output."""


def extrapolate(flags: Flags, command: str) -> None:
    """Evaluate policies; write the table and the report, and show the summary.

    Args:
        flags: Of the command.
        command: The command line, stored with the table.
    """
    function = any(is_function(str(each)) for each in flags.policies)
    with redirect_stdout(sys.stderr if flags.json else sys.stdout):  # environments and functions may print
        result = _evaluate_function(flags, command) if function else _evaluate_files(flags, command)
    table = result.path
    states = result.frame["policy_state"].unique().to_list()
    del result  # the report needs the memory
    assert table is not None
    if flags.normalizer == "none" and NeverWorked.name in states:
        tell(
            "with --normalizer none the policy sees raw observations; if it was trained behind VecNormalize, give the "
            "file that its save() wrote, often vecnormalize.pkl beside the model"
        )
    formats: tuple[Format, ...] = () if function else ("png",)  # the figures of a function are there
    write_and_show(table, flags.out, formats, flags.require, flags.json, judged=True)


def _evaluate_function(flags: Flags, command: str) -> ExtrapolationResult:
    """Evaluate a function of Python in this process."""
    if len(flags.policies) > 1 or flags.normalizer or flags.time_feature or flags.trust:
        raise PerdureError("a function is evaluated alone, without --normalizer, --time-feature and --trust")
    return _evaluate(flags, load_function(str(flags.policies[0])), flags.env, flags.training_horizon, command)


def _evaluate_files(flags: Flags, command: str) -> ExtrapolationResult:
    """Evaluate policy files, ONNX models and models of Stable-Baselines3, and draw stills of a failure."""
    from perdure.evaluate.run import takes_clock
    from perdure.evaluate.stills import add_stills
    from perdure.policy.onnx import is_onnx

    names = [str(each) for each in flags.policies]
    sb3 = {"normalizer": flags.normalizer, "time_feature": flags.time_feature, "trust": flags.trust}
    files = policy_files(names, flags.env, sb3, flags.training_horizon, flags.out, flags.modules)
    if flags.clocks != OWN_CLOCK and not any(map(takes_clock, files)):
        tell("no policy here has a time-to-go input, so --clocks has no effect")
    if any(map(is_onnx, files)):
        result = _evaluate(flags, files, flags.env, flags.training_horizon, command)
    else:  # the file of a policy names its task
        result = _evaluate(flags, files, None, None, command)
    add_stills(result.frame, result.files, files, flags.out, flags.on)
    return result


def _evaluate(
    flags: Flags, subject: Any, env: str | None, training_horizon: int | None, command: str
) -> ExtrapolationResult:
    from perdure.envs import module_of, task_of_environment
    from perdure.evaluate import extrapolate as evaluate
    from perdure.runs.progress import show_progress

    modules = flags.modules
    if flags.env is not None:
        named = module_of(task_of_environment(flags.env))
        modules += () if named is None else (named,)
    asked = replace(flags, policies=(), env=env, training_horizon=training_horizon, modules=modules)
    with show_progress("extrapolate", "steps") as observe:
        return evaluate(
            subject,
            evaluation=asked,
            out=flags.out,
            cores=flags.cores,
            on=flags.on,
            command=command,
            observe=observe,
            waiting=lambda: tell(f"waiting for another evaluation into {flags.out}"),
            stop_early=flags.require is not None,
        )


def report(table: tyro.conf.Positional[Path], out: Path | None = None, formats: tuple[Format, ...] = ("png",)) -> None:
    """Judge the episodes of a table that `perdure extrapolate` wrote, and make report.html and its figures.

    Nothing is simulated. Verdicts follow the rules of this version of perdure, from episodes.parquet and from
    baselines.parquet beside it. Without the second file, as in older results, the verdicts of the table are shown.

    Args:
        table: The table episodes.parquet, or the folder that holds it.
        out: Folder to write into; the table's own by default.
        formats: File formats of the figures beside the page.
    """
    table = find_table(table)
    if out is not None and out.is_dir():
        other = find_table(out)
        if other.exists() and not other.samefile(table):
            raise PerdureError(f"{out} holds another evaluation, whose report would be replaced: name another folder")
    write_and_show(table, out or table.parent, formats)


def find_table(path: Path) -> Path:
    """Return the table that a path means: in a folder its episodes.parquet."""
    if not path.is_dir():
        return path
    from perdure.evaluate.table import TABLE_FILE

    return path / TABLE_FILE


def write_and_show(
    table: Path,
    out: Path,
    formats: Sequence[Format] = ("png",),
    require: str | None = None,
    as_json: bool = False,
    *,
    judged: bool = False,
) -> None:
    """Write the report of a table into ``out``; print the summary and the path of the report.

    Args:
        table: The file.
        out: Folder of the report.
        formats: File formats of the figures beside the page.
        require: See `Flags`, as for `as_json`.
        as_json: Print the summary as JSON.
        judged: The verdicts of the table are those of this version: it was written a moment ago.

    Raises:
        SystemExit: With `NOT_HOLDING` if something in the table misses what is required.
    """
    from perdure.evaluate.judge import read_judged
    from perdure.report import estimate_table, read_episodes, summary_text, write_report
    from perdure.report.page import STILLS
    from perdure.report.schema import early_stop
    from perdure.report.summary import REQUIREMENTS, write_summary

    if judged:
        episodes, notes = read_episodes(table)
    else:
        episodes, notes = read_judged(table)
    estimates = estimate_table(episodes)
    del episodes  # of a large table
    if not as_json:
        print(summary_text(estimates))
    stopped = early_stop(notes)
    if stopped is not None:
        tell(str(stopped))
    command = notes.get("command", "")
    files = named_files(command)
    page = write_report(estimates, out, command, formats, notes, table.parent / STILLS, files).resolve()
    summary = write_summary(estimates, table, page, notes)
    print(summary.to_json() if as_json else f"\nReport: {page}")
    missed = [] if require is None else REQUIREMENTS[require](estimates)
    if missed:
        print(f"perdure: --require {require} is not met: {'; '.join(missed)}", file=sys.stderr)
        raise SystemExit(NOT_HOLDING)
