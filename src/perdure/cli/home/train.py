"""``perdure home train``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from perdure.cli.flags import Cores, On
from perdure.cli.home.flags import parse_home
from perdure.errors import PerdureError


@dataclass(frozen=True)
class HomeTrain:
    """Train a skill with its recipe and print its success rate on val starts. Interrupt it any time."""

    skill: tyro.conf.Positional[str]
    """pick, place, open_drawer, close_drawer, open_fridge, close_fridge or navigate."""
    task: str = "set_table"
    """The task whose objects and receptacles it is trained on."""
    delta: int = 1
    """For place: number of steps the object must stay."""
    limited_to: int | None = None
    """For place: step limit; 200 by default, 200 + delta with --delta."""
    rolling: Literal["friction", "drag"] = "friction"
    """Rolling resistance, as for `perdure home run`."""
    seeds: tuple[int, ...] = (0,)
    """Training seeds, such as 0 1 2, trained side by side."""
    steps: int | None = None
    """Environment steps; the recipe's by default."""
    test_episodes: int = 200
    """Episodes on val starts after training."""
    out: Path = Path("runs")
    """Folder of the runs."""
    cores: Cores = None
    on: On = "local"


def main(args: list[str]) -> None:
    """Run ``perdure home train``."""
    flags = parse_home(HomeTrain, args, "train")
    from perdure.home.skills.train import FLAGS, evaluate_skill, train_skill
    from perdure.policy import load_policy
    from perdure.runs.progress import show_progress

    if flags.test_episodes < 1:
        raise PerdureError(f"--test-episodes must be 1 or more, not {flags.test_episodes}")
    usual = HomeTrain(flags.skill)
    options = {name: value for name in FLAGS if (value := getattr(flags, name)) != getattr(usual, name)}
    with show_progress(f"{flags.task} {flags.skill}", "steps") as observe:
        paths = train_skill(
            *(flags.skill, flags.task, flags.seeds, flags.out, flags.steps),
            cores=flags.cores,
            on=flags.on,
            observe=observe,
            **options,
        )
    for path in paths:
        score = evaluate_skill(load_policy(path), flags.skill, flags.test_episodes, task=flags.task, **options)
        print(f"{path}\n  {score.summary()}")
