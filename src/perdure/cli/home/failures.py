"""``perdure home failures``."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from perdure.cli.home.flags import log_files, parse_home, policies
from perdure.cli.parse import check_folder


@dataclass(frozen=True)
class HomeFailures:
    """Replay failed episodes, drawn at random, and show the cause of each failure in eight pictures.

    The policies that the logs name act again. Where the replay gets another label (other code, other policies) the line
    says "replayed: ..."; the command then ends with code 1.
    """

    logs: tyro.conf.Positional[tuple[Path, ...]]
    """Log files, or folders that hold some."""
    count: int = 10
    """Number of episodes; all when fewer have failed."""
    seed: int = 0
    """Seed of the draw."""
    counting: Literal["latched", "stabilizing"] = "stabilizing"
    """Definition of failure: latched (the benchmark's), stabilizing (placements must also last)."""
    policies: tuple[str, ...] = ()
    """SKILL=FILE or SKILL=oracle, as for `perdure home run`, in place of the policies that the logs name."""
    out: Path = Path("failures")
    """Folder for the pictures."""


def main(args: list[str]) -> None:
    """Run ``perdure home failures``."""
    flags = parse_home(HomeFailures, args, "failures")
    from perdure.film import check_film, open_context, save_picture
    from perdure.home.failures import failure_sheet, logged_agent, read_failures, replay_failure, sample_failures

    chosen = policies(flags.policies)
    check_folder(flags.out)
    drawn = sample_failures(read_failures(log_files(flags.logs), flags.counting), flags.count, flags.seed)
    if not drawn:
        print(f"no episode of these logs failed ({flags.counting})")
        return
    # Errors are found before anything runs: missing policies, changed episodes, a machine that cannot render.
    assigned = {failure.assignment: failure for failure in drawn}
    agents = {assignment: logged_agent(failure, chosen) for assignment, failure in assigned.items()}
    _ = [failure.episode for failure in drawn]
    check_film(flags.out / drawn[0].file_name, (".png",))
    open_context(16, 16).free()
    others = 0
    for failure in drawn:
        replay = replay_failure(failure, agents[failure.assignment])
        path = save_picture(failure_sheet(failure, replay), flags.out / failure.file_name)
        differs = replay.label != failure.label
        others += differs
        again = f", replayed: {failure.words(replay.label)}" if differs else ""
        print(f"{failure.line}, {path}{again}", flush=True)
    if others:
        reason = "the code or the policies are not those of the logs"
        sys.exit(f"perdure: {others} of {len(drawn)} episodes got another label: {reason}")
