"""``perdure home view``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import tyro

from perdure.cli.home.flags import parse_home


@dataclass(frozen=True)
class HomeView:
    """Show the oracle in an episode live in a browser. Interrupt it to end."""

    task: tyro.conf.Positional[str]
    """tidy_house, prepare_groceries or set_table."""
    split: str = "val"
    """val or eval."""
    index: int = 0
    """Number of the episode in its split."""
    port: int = 8080
    """Port of the server on this machine."""
    speed: float = 1.0
    """Playback speed relative to real time."""
    eval_seed: int = 0
    """Draws the robot's start pose."""


def main(args: list[str]) -> None:
    """Run ``perdure home view``."""
    flags = parse_home(HomeView, args, "view")
    from perdure.home.film import serve_episode
    from perdure.home.tasks.episodes import load_episodes

    episode = load_episodes(flags.task, flags.split)[flags.index]
    try:
        serve_episode(episode, flags.port, flags.speed, flags.eval_seed, report=partial(print, flush=True))
    except KeyboardInterrupt:
        print()
