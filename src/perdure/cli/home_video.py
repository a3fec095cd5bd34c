"""``perdure home video``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import tyro

from perdure.cli.parse import parse


@dataclass(frozen=True)
class HomeVideo:
    """Film the oracle at an episode, without a screen."""

    task: tyro.conf.Positional[str]
    """tidy_house, prepare_groceries or set_table."""
    split: str = "val"
    """val or eval."""
    index: int = 0
    """Which of the split's episodes."""
    out: Path = Path("home.mp4")
    """The film: .mp4 or .gif; .png gives a sheet with one picture for each stage."""
    camera: str = "follow"
    """follow, doll_house, plan, head or hand."""
    size: tuple[int, int] = (720, 480)
    """Width and height in pixels, even."""
    speed: float = 4.0
    """How much faster than life it runs."""
    seconds: float = math.inf
    """Simulated time after which it ends."""
    seed: int = 0
    """Evaluation seed: draws where the robot starts."""


def main(args: list[str]) -> None:
    """``perdure home video``."""
    flags = parse(HomeVideo, args, "home video")
    from perdure.home.episodes import load_episodes
    from perdure.home.view import FilmOptions, contact_sheet, film_episode, save_picture

    episode = load_episodes(flags.task, flags.split)[flags.index]
    options = FilmOptions(flags.camera, flags.size, flags.speed, flags.seconds, flags.seed)
    if flags.out.suffix.lower() == ".png":
        sheet, log = contact_sheet(episode, options=options)
        save_picture(sheet, flags.out, colors=256)
    else:
        log = film_episode(episode, flags.out, options)
    if log is not None:
        reached = sum(log.latched)
        print(f"{reached} of {len(log.latched)} stages reached in {log.steps} steps")
    print(flags.out)
