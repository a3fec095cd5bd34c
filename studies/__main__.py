"""``python -m studies NAME``: run a study from the root of a clone of the repository."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import tyro

from perdure.cli.parse import Cores, On, check_folder
from perdure.errors import PerdureError
from perdure.runs import Store, Unit, check_on, read_unit_progress, run_missing
from perdure.runs.progress import count_states, show_progress, total_share


@dataclass(frozen=True)
class StudyFlags:
    """Run a study: train, evaluate, analyze. An interrupted command continues when you run it again.

    Several commands share a study, also on several machines: each takes what no other is working on.
    """

    name: tyro.conf.Positional[Literal["horizon", "placement", "disturbance", "cure", "agents"]]
    """The study."""
    scale: str | None = None
    """Size of the study: smoke (minutes), laptop (a night) or thesis (hours to days). By default the smallest that the
    study has."""
    out: Path | None = None
    """Folder of the results; by default results/NAME for thesis and runs/NAME-SCALE for the others. Runs are kept in
    its folder runs."""
    on: On = "local"
    cores: Cores = None
    phases: tuple[int, ...] | None = None
    """Only these phases of the study, by number; all if left out."""
    status: bool = False
    """Show the progress, also of a study that is running, and exit."""
    analyze_only: bool = False
    """Write tables and figures again from the results that exist; train and evaluate nothing."""
    collect: Path | None = None
    """Of horizon: copy the finished runs in this folder, such as one of `perdure train --out`, into the results, then
    analyze."""


def main(args: list[str]) -> None:
    """Run the command line; an error that a user can cause ends in one line and exit code 2."""
    try:
        run(tyro.cli(StudyFlags, args=args, prog="python -m studies"))
    except KeyboardInterrupt:
        print("studies: interrupted; run the same command to continue", file=sys.stderr)
        raise SystemExit(130) from None
    except (PerdureError, OSError) as error:
        print(f"studies: {error}", file=sys.stderr)
        raise SystemExit(2) from None


def run(flags: StudyFlags) -> None:
    """Run, show or analyze a study."""
    study: Any = import_module(f"studies.{flags.name}.study")
    if flags.scale is None:
        flags = replace(flags, scale=next(iter(study.SCALES)))
    if flags.scale not in study.SCALES:
        raise PerdureError(f"study {flags.name} has no scale {flags.scale!r}; its scales are {', '.join(study.SCALES)}")
    out = flags.out or study.SCALES[flags.scale] or Path("runs", f"{flags.name}-{flags.scale}")
    check_folder(out)
    if flags.collect is not None:
        _collect(study, flags.collect, flags.name, out)
    elif not flags.analyze_only:
        check_on(flags.on)
        units = _planned_units(study, flags, out)
        if flags.status:
            _print_status(units, flags, out)
            return
        print(f"study {flags.name}: {study.QUESTION}\nscale {flags.scale}, in {out}", flush=True)
        store = out / "runs"
        Store(store).warn_of_other_source(unit.key for unit in units)
        with show_progress(f"study {flags.name}") as observe:
            run_missing(units, store, flags.on, flags.cores, observe, _say_waiting)
    written = study.analyze(flags.scale, out)
    text = f"{len(written)} tables, figures and pages written"
    if written:
        text += f", such as {written[-1]}"
    print(text)


def _collect(study: Any, finished: Path, name: str, out: Path) -> None:
    """Copy finished runs into the results; PerdureError if there is none, or the study takes none."""
    if name != "horizon":
        raise PerdureError("--collect belongs to the study horizon")
    collected = study.collect(finished, out)
    if not collected:
        raise PerdureError(f"there is no finished training run in {finished}")
    print(f"{len(collected)} tables and policies written")


def _planned_units(study: Any, flags: StudyFlags, out: Path) -> list[Unit]:
    """Return the units of the phases that were asked for; PerdureError if the study has no such phase."""
    phases = flags.phases or tuple(study.PHASES)
    unknown = sorted(set(phases) - set(study.PHASES))
    if unknown:
        raise PerdureError(f"study {flags.name} has no phase {unknown[0]}; its phases are {[*study.PHASES]}")
    return list(study.plan(flags.scale, phases, out / "runs"))


def _print_status(units: Sequence[Unit], flags: StudyFlags, out: Path) -> None:
    store = out / "runs"
    text = "  finished: its tables are kept, its units are not"
    if store.is_dir() or not out.is_dir():
        text = status_text(units, store)
    print(f"study {flags.name}, scale {flags.scale}, in {out}\n{text}")


def _say_waiting() -> None:
    print("studies: another command is running the rest; waiting for it", file=sys.stderr)


def status_text(units: Sequence[Unit], folder: Path) -> str:
    """Return how many units are finished, and the share of the work, by what they run."""
    store = Store(folder)
    lines = []
    for function in dict.fromkeys(unit.function for unit in units):
        mine = [unit for unit in units if unit.function == function]
        status = {unit.key: read_unit_progress(store, unit) for unit in mine}
        failed = sum(store.note_path("failures", key).exists() for key in status)
        name = function.rpartition(":")[2].replace("_", " ")
        lines.append(f"  {name:16} {count_states(status)}, {failed} failed ({total_share(status):.0%} of the work)")
    return "\n".join(lines)


if __name__ == "__main__":
    main(sys.argv[1:])
