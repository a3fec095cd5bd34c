"""``perdure study``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from perdure.cli.errors import CommandError
from perdure.cli.flags import Cores, On
from perdure.cli.parse import check_folder, parse

if TYPE_CHECKING:
    from perdure.studies import Study


@dataclass(frozen=True)
class StudyFlags:
    """Run a study: train, evaluate, analyze. An interrupted command resumes when you run it again."""

    name: tyro.conf.Positional[str]
    """A study: horizon or placement."""
    scale: Literal["smoke", "laptop", "thesis", "replication"] = "smoke"
    """Size of the study: smoke (minutes), laptop (a night), thesis (days) or, of horizon, replication (a day)."""
    out: Path | None = None
    """Folder of the results; by default results/NAME for thesis, results/NAME-replication for replication and
    runs/NAME-SCALE for the others."""
    on: On = "local"
    cores: Cores = None
    phases: tuple[int, ...] | None = None
    """Only these phases of the study, by number; its default phases if left out."""
    status: bool = False
    """Show the progress, also of a study that is running, and exit."""
    analyze_only: bool = False
    """Write tables, figures and pages again from the results that exist; train and evaluate nothing."""


def main(args: list[str]) -> None:
    """``perdure study``."""
    flags = parse(StudyFlags, args, "study")
    from perdure.runs import check_on, core_count
    from perdure.studies import find_study
    from perdure.studies.run import check_page, check_results

    if flags.status and flags.analyze_only:
        raise CommandError("--status and --analyze-only exclude each other")
    study = find_study(flags.name)
    scale, phases = flags.scale, flags.phases or study.phases
    out = flags.out or study.folder(scale)
    check_folder(out)
    if flags.status:
        _show_status(study, scale, out, phases)
        return
    check_page(study, out)
    if flags.analyze_only:
        check_results(study, out)
    else:
        check_on(flags.on)
        _carry_out(study, scale, out, phases, flags, core_count(flags.cores))
    written = study.analyze(scale, out)
    print(f"\n{len(written)} tables, figures and pages written, such as {written[-1].resolve()}")


def _show_status(study: Study, scale: str, out: Path, phases: Sequence[int]) -> None:
    from perdure.studies.status import failed_steps, lines, read_step_progress, status_text

    steps = study.plan(scale, out, phases)
    progress = read_step_progress(steps)
    print(f"study {study.name}, scale {scale}, in {out}\n{status_text(lines(steps, progress))}")
    for key in failed_steps(steps, progress):
        print(f"  failed: {key}")


def _carry_out(study: Study, scale: str, out: Path, phases: Sequence[int], flags: StudyFlags, cores: int) -> None:
    from perdure.runs.progress import show_progress
    from perdure.studies.run import run_steps
    from perdure.studies.speed import measure_speeds
    from perdure.studies.status import cost_text, lines, read_step_progress
    from perdure.studies.study import RunOptions

    steps = study.plan(scale, out, phases)
    progress = read_step_progress(steps)
    open_tasks = [step.task for step in steps if step.task and progress[step.key].done < progress[step.key].total]
    speeds = {**{step.task: 1.0 for step in steps}, **measure_speeds(open_tasks)}
    print(f"study {study.name}: {study.question}\nscale {scale}, in {out}; left to do at the speed measured now:")
    print(cost_text(lines(steps, progress, speeds, cores), cores), flush=True)
    sizes = {step.key: step.seconds(speeds[step.task]) for step in steps}
    with show_progress(f"study {study.name}") as observe:
        waiting = _say("another command is running this step; waiting for it")
        options = RunOptions(flags.on, flags.cores, observe, waiting)
        run_steps(steps, options, sizes, lambda line: print(f"perdure: {line}", file=sys.stderr))


def _say(line: str) -> Callable[[], None]:
    return lambda: print(f"perdure: {line}", file=sys.stderr)
