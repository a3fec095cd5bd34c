"""The command ``compare``: which of two policies, of two methods, or of many policies is best."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import tyro

from perdure.cli.extrapolate import NOT_HOLDING
from perdure.cli.parse import Cores, Normalizer, On, TimeFeature, Trust, call, whole_command
from perdure.cli.subjects import is_function, load_function, policy_sides, tell
from perdure.envs import module_of, task_of_environment
from perdure.errors import PerdureError
from perdure.evaluate.compare import TABLE, Comparison, ComparisonResult, RankingResult, rank
from perdure.evaluate.compare import compare as compare_sides
from perdure.policy.onnx import is_onnx
from perdure.report.comparison_page import PAGE, document_text, ranking_document, summary_document
from perdure.runs.progress import show_progress


def main(name: str, args: list[str]) -> None:
    """Run the command."""
    compare(call(Flags, args, name), whole_command(args, name))


@dataclass(frozen=True, kw_only=True)
class Flags(Comparison):
    """Is policy B better than policy A? Both meet the same start states and disturbances.

    The difference in work under standard-1, small disturbances, decides. Two policies get start states until it is
    decided. Folders of several training runs are compared as methods, over runs. One folder, or three and more
    policies, are ranked, and the best is confirmed on fresh start states. Writes comparison.parquet and
    comparison.html. An interrupted command resumes when you run it again, and episodes of an evaluation in the same
    folder are reused.
    """

    policies: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="A [B [STR ...]]")] = ()
    """A, the baseline, and B: each as `perdure extrapolate` takes it, or a folder of training runs."""
    normalizer: Normalizer = None
    time_feature: TimeFeature = None
    trust: Trust = False
    out: Path = Path("comparison")
    """Folder for the results. Finished parts of an interrupted comparison are kept there."""
    cores: Cores = None
    on: On = "local"
    json: bool = False
    """Print the answer as one JSON document, and nothing else on standard output."""


def compare(flags: Flags, command: str) -> None:
    """Compare or rank policies, and show the answer.

    Args:
        flags: Of the command.
        command: The command line, stored with the results.

    Raises:
        SystemExit: With `NOT_HOLDING` if something is required and not shown.
    """
    with redirect_stdout(sys.stderr if flags.json else sys.stdout):  # environments and functions may print
        result = _run(flags, command)
    page = flags.out / PAGE
    if flags.json:
        print(document_text(_document(result), table=flags.out / TABLE, page=page))
    else:
        print(f"{result}\n\nReport: {page.resolve()}")
    if isinstance(result, ComparisonResult) and not result.met:
        print(f"perdure: --require {flags.require} is not met", file=sys.stderr)
        raise SystemExit(NOT_HOLDING)


def _document(result: ComparisonResult | RankingResult) -> dict[str, Any]:
    if isinstance(result, RankingResult):
        return ranking_document(result.ranking)
    return {**summary_document(result.summary), "not_worse": result.not_worse}


def _run(flags: Flags, command: str) -> ComparisonResult | RankingResult:
    """Return the answer: a comparison of two sides, or a ranking."""
    names = [str(each) for each in flags.policies]
    if not names:
        raise PerdureError("no policy to compare: name A and B")
    sides: list[Any]
    if any(map(is_function, names)):
        sides = [load_function(name) if is_function(name) else name for name in names]
    else:
        sb3 = {"normalizer": flags.normalizer, "time_feature": flags.time_feature, "trust": flags.trust}
        found = policy_sides(names, flags.env, sb3, flags.training_horizon, flags.out, flags.modules)
        sides = [list(side) for side in found]
    asked = _options(flags, names)
    if flags.require is not None and len(sides) != 2:
        raise PerdureError("--require needs two sides, A and B")
    with show_progress("compare", "steps") as observe:
        where: dict[str, Any] = {"out": flags.out, "cores": flags.cores, "on": flags.on, "observe": observe}
        where |= {"command": command, "waiting": lambda: tell(f"waiting for another evaluation into {flags.out}")}
        if len(sides) == 2:
            return compare_sides(sides[0], sides[1], comparison=asked, **where)
        return rank(sides, comparison=asked, **where)


def _options(flags: Flags, names: Sequence[str]) -> Flags:
    """Return the options without the policies; the files of policies name their environment themselves."""
    modules = flags.modules
    if flags.env is not None:
        named = module_of(task_of_environment(flags.env))
        if named is not None:
            modules += (named,)
    if any(is_function(name) or is_onnx(name) for name in names):
        return replace(flags, policies=(), modules=modules)
    return replace(flags, policies=(), modules=modules, env=None, training_horizon=None)
