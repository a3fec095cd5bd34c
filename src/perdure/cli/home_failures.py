"""``perdure home failures``."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from perdure.cli.parse import check_folder, log_files, parse, policies


@dataclass(frozen=True)
class HomeFailures:
    """Run failed episodes again, drawn at random, and show in eight pictures each what its label is about.

    The policies that the logs name act again. An episode whose label comes out otherwise (other code, other policies)
    says "replayed: ..."; the command then ends with code 1.
    """

    logs: tyro.conf.Positional[tuple[Path, ...]]
    """Files of logs, or folders that hold some."""
    count: int = 10
    """How many episodes; all when fewer have failed."""
    seed: int = 0
    """Of the draw."""
    counting: Literal["latched", "stabilizing"] = "stabilizing"
    """What counts as failed: latched (the benchmark's way), stabilizing (placements must last)."""
    policies: tuple[str, ...] = ()
    """SKILL=FILE or SKILL=oracle, as for `perdure home run`: in place of the policy that the logs name."""
    out: Path = Path("failures")
    """Folder for the pictures."""


def main(args: list[str]) -> None:
    """``perdure home failures``."""
    flags = parse(HomeFailures, args, "home failures")
    from perdure.home.sim.camera.gl import open_context
    from perdure.home.video import draw, failure_sheet, read_failures, run_again, save_picture, take_again

    chosen = policies(flags.policies)
    check_folder(flags.out)
    paths = log_files(flags.logs)
    drawn = draw(read_failures(paths, flags.counting), flags.count, flags.seed)
    if not drawn:
        print(f"no episode of these logs failed ({flags.counting})")
        return
    # Whatever is wrong is found out before anything runs: policies, other episodes, a machine that cannot draw.
    casts = {failure.assignment: failure for failure in drawn}
    takes = {assignment: take_again(failure, chosen) for assignment, failure in casts.items()}
    _ = [failure.episode for failure in drawn]
    open_context(16, 16).free()
    others = 0
    for failure in drawn:
        replay = run_again(failure, takes[failure.assignment])
        path = save_picture(failure_sheet(failure, replay), flags.out / failure.file_name)
        differs = replay.label != failure.label
        others += differs
        again = f", replayed: {failure.words(replay.label)}" if differs else ""
        print(f"{failure.line}, {path}{again}", flush=True)
    if others:
        reason = "the code or the policies are not those of the logs"
        sys.exit(f"perdure: {others} of {len(drawn)} episodes got another label: {reason}")
