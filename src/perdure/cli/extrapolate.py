"""``perdure extrapolate``."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import tyro

from perdure.cli.parse import parse
from perdure.cli.report import write_and_show
from perdure.cli.terminal import command_line


@dataclass(frozen=True)
class Extrapolate:
    """Run policies for T_test steps under several clocks, write lanes.parquet, report.html and figures."""

    policies: tyro.conf.Positional[tuple[str, ...]]
    """Policy files, or names of shipped policies (`perdure list policies`), all for one task."""
    steps: int = 100_000
    """T_test: how long each lane is asked to last."""
    clocks: tuple[str, ...] = ("default",)
    """What policies with a time-to-go input are told: constant:500, periodic:500, countdown (to T_test),
    countdown:1000, default (each policy's own clock), sweep (constant and periodic 0, 100, ..., 1000)."""
    eval_seeds: int = 20
    """Start states; the same ones for every policy and clock."""
    first_eval_seed: int = 0
    """The first of them: choose a policy or a clock on some start states, report on others."""
    out: Path = Path("extrapolation")
    """Folder for the table and the report. Finished parts of an interrupted evaluation are kept there."""
    cores: int | None = None
    """Cores to use; all by default. Results do not depend on it."""
    on: str = "local"
    """Where to run: local (a process for each core), ray (a local Ray) or ray:ADDRESS (a Ray cluster)."""
    max_lanes: int = 48
    """Lanes that share a process at a time."""
    modules: tuple[str, ...] = ()
    """Python modules that the policies' tasks may import; a policy file alone never imports anything."""


def main(args: list[str]) -> None:
    """``perdure extrapolate``."""
    flags = parse(Extrapolate, args, "extrapolate")
    from perdure.extrapolate import Extrapolation
    from perdure.extrapolate import extrapolate as evaluate
    from perdure.policy.shipped import find_policy
    from perdure.runs.progress import show_progress

    evaluation = Extrapolation(
        tuple(find_policy(name) for name in flags.policies),
        flags.steps,
        flags.clocks,
        flags.eval_seeds,
        first_eval_seed=flags.first_eval_seed,
        max_lanes=flags.max_lanes,
        modules=flags.modules,
    )
    command = command_line("perdure", "extrapolate", *args)
    with show_progress("extrapolate", "steps") as observe:
        result = evaluate(
            evaluation,
            flags.out,
            cores=flags.cores,
            on=flags.on,
            command=command,
            observe=observe,
            waiting=lambda: print(f"perdure: waiting for another evaluation into {flags.out}", file=sys.stderr),
        )
    write_and_show(result.path, flags.out)
