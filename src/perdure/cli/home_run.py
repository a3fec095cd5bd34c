"""``perdure home run``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from perdure.cli.parse import check_folder, parse, policies
from perdure.cli.terminal import command_line

if TYPE_CHECKING:
    from perdure.home.evaluate.protocol import Protocol


@dataclass(frozen=True)
class HomeRun:
    """Run the benchmark's protocol: episodes x training seeds x evaluation seeds. Interrupt it any time.

    The report of what this command ran lies beside its logs; `perdure home analyze` sets several arms side by side.
    """

    task: tyro.conf.Positional[str]
    """tidy_house, prepare_groceries or set_table."""
    place: str = "rl"
    """How objects are let go: rl (the policy alone), stop, ik, ik+, delta-N or delta-N-in-M (trained to make objects
    stay for N steps, with 200 + N or M steps for it)."""
    split: str = "val"
    """val (new arrangements of known apartments) or eval (new apartments)."""
    episodes: int = 100
    """How many of the split's episodes."""
    train_seeds: int = 1
    """Policies of how many training seeds."""
    vary: Literal["all", "place"] = "all"
    """Which policies the training seeds tell apart: those of all skills, or place alone (the others are of seed 0)."""
    eval_seeds: int = 1
    """How many draws of where the robot starts."""
    policies: tuple[str, ...] = ()
    """SKILL=FILE or SKILL=oracle ({seed}: the training seed), or `oracle`; else shipped policies, else the oracle."""
    jaws: Literal["never", "apart"] = "never"
    """Whether an object that was held touches the robot again: never (M3) or once they are apart (habitat-lab)."""
    rolling: Literal["friction", "drag"] = "friction"
    """What stops objects that roll: rolling friction, or nothing but a drag of 20 % a second (no rolling friction)."""
    apple: Literal["sphere", "hull"] = "sphere"
    """Collision shape of the apple: a sphere, or a convex hull of 2,000 corners (Habitat-sim collides hulls)."""
    release_velocity: Literal["kept", "base-removed", "zero"] = "kept"
    """Velocity of an object as the hand opens: unchanged; without the moving base's part (M3 teleports the base with
    what it holds); or zero."""
    physics_hz: int = 120
    """Physics steps per second."""
    lanes: int = 50
    """Episodes side by side. Results do not depend on it."""
    cores: int | None = None
    """Cores to use; all by default. Results do not depend on it."""
    on: str = "local"
    """Where to run: local (a process for each core), ray (a local Ray) or ray:ADDRESS (a Ray cluster)."""
    out: Path = Path("home-runs")
    """Where logs are kept."""


def make_protocol(flags: HomeRun) -> Protocol:
    """Return what the flags ask for."""
    from perdure.home.evaluate.execute import ExecutorOptions
    from perdure.home.evaluate.protocol import Protocol
    from perdure.home.sim.world import SceneOptions

    scene = SceneOptions(
        physics_hz=flags.physics_hz,
        rolling=flags.rolling,
        apple=flags.apple,
        release_velocity=flags.release_velocity,
    )
    options = ExecutorOptions(lanes=flags.lanes, jaws=flags.jaws, scene=scene)
    counts = flags.episodes, flags.train_seeds, flags.eval_seeds
    return Protocol(flags.task, flags.place, flags.split, *counts, flags.vary, policies(flags.policies), options)


def main(args: list[str]) -> None:
    """``perdure home run``."""
    flags = parse(HomeRun, args, "home run")
    from perdure.home.evaluate.outcomes import analyze
    from perdure.home.evaluate.page import read_cast, write_page
    from perdure.home.evaluate.protocol import run_protocol
    from perdure.runs.progress import show_progress

    check_folder(flags.out)
    protocol = make_protocol(flags)
    for train_seed in range(flags.train_seeds):  # a missing file is found out before there is a progress bar
        protocol.cast(train_seed)
    command = command_line("perdure", "home", "run", *args)
    with show_progress(f"{flags.task} {flags.place}", "episodes") as observe:
        paths = run_protocol(protocol, flags.out, cores=flags.cores, on=flags.on, command=command, observe=observe)
    records, cast = read_cast(paths)
    analysis = analyze(records)
    page = write_page(analysis, flags.out / protocol.folder, command, cast)
    print(analysis.summary())
    print(f"\nlogs: {flags.out}\nReport: {page.resolve()}")
