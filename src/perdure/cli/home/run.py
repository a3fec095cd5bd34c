"""``perdure home run``."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from perdure.cli.flags import Cores, On
from perdure.cli.home.flags import parse_home, policies
from perdure.cli.parse import check_folder
from perdure.cli.terminal import command_line
from perdure.home.sim.scene import SceneOptions, WorldOptions

if TYPE_CHECKING:
    from perdure.home.evaluate.protocol import EvaluationProtocol


@dataclass(frozen=True)
class HomeRun:
    """Run the benchmark's protocol: episodes x training seeds x evaluation seeds. Interrupt it any time.

    The report lies beside the logs. `perdure home analyze` compares several release strategies.
    """

    task: tyro.conf.Positional[str]
    """tidy_house, prepare_groceries or set_table."""
    place: str = "rl"
    """Release strategy: what happens when the policy commands the hand to open. rl: it opens at once. Hand-overs, in
    which the policy waits: stop (the robot stops first), ik (then lowers the hand by 5 cm), ik+ (then lowers the object
    until contact). delta-N, delta-N-in-M: a policy trained to make objects stay for N steps, within 200 + N or M."""
    split: str = "val"
    """val (new arrangements of known apartments) or eval (new apartments)."""
    episodes: int = 100
    """Number of episodes of the split, from its first one."""
    train_seeds: int = 1
    """Number of training seeds, from seed 0; each has its own policies."""
    vary: Literal["all", "place"] = "all"
    """Which skills' policies change with the training seed: all, or place alone (the others are those of seed 0)."""
    eval_seeds: int = 1
    """Number of evaluation seeds; each draws the robot's start poses."""
    policies: tuple[str, ...] = ()
    """SKILL=FILE or SKILL=oracle ({seed}: the training seed), or `oracle`; else shipped policies, else the oracle."""
    world: tyro.conf.OmitArgPrefixes[WorldOptions] = field(default_factory=WorldOptions)
    """The variant of the physics."""
    max_lanes: int = 50
    """Episodes that share a process at a time. Results do not depend on it."""
    cores: Cores = None
    on: On = "local"
    out: Path = Path("home-runs")
    """Folder of the logs."""


def make_protocol(flags: HomeRun) -> EvaluationProtocol:
    """Return the protocol of the flags."""
    from perdure.errors import PerdureError
    from perdure.home.evaluate.execute import ExecutorOptions
    from perdure.home.evaluate.protocol import EvaluationProtocol

    if flags.max_lanes < 1:
        raise PerdureError(f"--max-lanes must be 1 or more, not {flags.max_lanes}")
    options = ExecutorOptions(lanes=flags.max_lanes, scene=SceneOptions(**vars(flags.world)))
    same = {each.name: getattr(flags, each.name) for each in fields(EvaluationProtocol) if hasattr(flags, each.name)}
    return EvaluationProtocol(**{**same, "policies": policies(flags.policies), "options": options})


def main(args: list[str]) -> None:
    """Run ``perdure home run``."""
    flags = parse_home(HomeRun, args, "run")
    from perdure.home.evaluate.analysis import analyze
    from perdure.home.evaluate.page import read_all, summary_text, write_page
    from perdure.home.evaluate.protocol import run_protocol
    from perdure.runs.progress import show_progress

    check_folder(flags.out)
    protocol = make_protocol(flags)
    for train_seed in range(flags.train_seeds):  # missing files are reported before a progress bar appears
        protocol.assignment(train_seed)
    command = command_line("perdure", "home", "run", *args)
    with show_progress(f"{flags.task} {flags.place}", "episodes") as observe:
        paths = run_protocol(protocol, flags.out, cores=flags.cores, on=flags.on, command=command, observe=observe)
    records, notes = read_all(paths)
    analysis = analyze(records)
    page = write_page(analysis, flags.out / protocol.folder, command, notes)
    print(summary_text(analysis, notes))
    print(f"\nLogs: {flags.out}\nReport: {page.resolve()}")
