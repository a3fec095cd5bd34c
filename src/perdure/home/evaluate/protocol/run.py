"""The benchmark's protocol: episodes x training seeds x evaluation seeds for one task and strategy, resumable."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from perdure.home.evaluate.protocol.protocol import EvaluationProtocol
from perdure.home.evaluate.protocol.units import LOGS, protocol_units
from perdure.runs import Observer, Store, run_missing


def run_protocol(
    protocol: EvaluationProtocol,
    out: str | Path,
    *,
    cores: int | None = None,
    on: str = "here",
    command: str = "",
    observe: Observer = lambda status: None,
    waiting: Callable[[], None] = lambda: None,
) -> list[Path]:
    """Run what is missing of a protocol and return the paths of all its logs.

    Args:
        protocol: What to run.
        out: Folder of the store. The same call resumes an interrupted one.
        cores: Cores to use; all by default. Results do not depend on it.
        on: Where to run, see `perdure.runs.make_workers`.
        command: The command that asked for it, noted in new logs.
        observe: Called with the progress of every unit, measured in episodes.
        waiting: Called once, before waiting for units that other commands run.

    Raises:
        HomeError: If a policy is missing, before anything is run.
        RunError: If a unit failed.
    """
    store, units = Store(out), list(protocol_units(protocol, command))
    store.warn_of_other_source(unit.key for unit in units)
    run_missing(units, out, on, cores, observe, waiting)
    return [store.get(unit.key, unit.config) / LOGS for unit in units]
