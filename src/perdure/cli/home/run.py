"""``perdure home run``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from perdure.cli.flags import Cores, On
from perdure.cli.home.flags import parse_home, policies
from perdure.cli.parse import check_folder
from perdure.cli.terminal import command_line

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
    jaws: Literal["never", "apart"] = "never"
    """When a released object collides with the gripper's jaws and the rest of the robot again: never
    (hab-mobile-manipulation), or once they are apart (habitat-lab)."""
    rolling: Literal["friction", "drag"] = "friction"
    """Rolling resistance: friction, or only a drag that takes 20 % of the speed per second."""
    apple: Literal["sphere", "hull"] = "sphere"
    """Collision shape of the apple: a sphere, or a convex hull of 2,000 corners (Habitat-sim collides hulls)."""
    release_velocity: Literal["kept", "base-removed", "zero"] = "kept"
    """Velocity of an object as the hand opens: unchanged; without the moving base's part
    (hab-mobile-manipulation teleports the base with what it holds); or zero."""
    physics_hz: int = 120
    """Physics steps per second: 120 or more, a multiple of 30."""
    max_lanes: int = 50
    """Episodes that share a process at a time. Results do not depend on it."""
    cores: Cores = None
    on: On = "local"
    out: Path = Path("home-runs")
    """Folder of the logs."""


def make_protocol(flags: HomeRun) -> EvaluationProtocol:
    """Return the protocol of the flags."""
    from perdure.home.errors import HomeError
    from perdure.home.evaluate.execute import ExecutorOptions
    from perdure.home.evaluate.protocol import EvaluationProtocol
    from perdure.home.sim.world import SceneOptions

    scene = SceneOptions(
        physics_hz=flags.physics_hz,
        rolling=flags.rolling,
        apple=flags.apple,
        release_velocity=flags.release_velocity,
    )
    if flags.max_lanes < 1:
        raise HomeError(f"--max-lanes must be 1 or more, not {flags.max_lanes}")
    options = ExecutorOptions(lanes=flags.max_lanes, jaws=flags.jaws, scene=scene)
    counts = flags.episodes, flags.train_seeds, flags.eval_seeds
    return EvaluationProtocol(
        flags.task, flags.place, flags.split, *counts, flags.vary, policies(flags.policies), options
    )


def main(args: list[str]) -> None:
    """Run ``perdure home run``."""
    flags = parse_home(HomeRun, args, "run")
    from perdure.home.evaluate.outcomes import analyze
    from perdure.home.evaluate.page import read_assignment, write_page
    from perdure.home.evaluate.protocol import run_protocol
    from perdure.runs.progress import show_progress

    check_folder(flags.out)
    protocol = make_protocol(flags)
    for train_seed in range(flags.train_seeds):  # missing files are reported before a progress bar appears
        protocol.assignment(train_seed)
    command = command_line("perdure", "home", "run", *args)
    with show_progress(f"{flags.task} {flags.place}", "episodes") as observe:
        paths = run_protocol(protocol, flags.out, cores=flags.cores, on=flags.on, command=command, observe=observe)
    records, assignment = read_assignment(paths)
    analysis = analyze(records)
    page = write_page(analysis, flags.out / protocol.folder, command, assignment)
    print(analysis.summary())
    print(f"\nLogs: {flags.out}\nReport: {page.resolve()}")
