"""``perdure home view``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import tyro

from perdure.cli.parse import parse


@dataclass(frozen=True)
class HomeView:
    """Watch the oracle at an episode in a browser. Interrupt it to end."""

    task: tyro.conf.Positional[str]
    """tidy_house, prepare_groceries or set_table."""
    split: str = "val"
    """val or eval."""
    index: int = 0
    """Which of the split's episodes."""
    port: int = 8080
    """Of the page's server on this machine."""
    speed: float = 1.0
    """How much faster than life it runs."""
    seed: int = 0
    """Evaluation seed: draws where the robot starts."""


def main(args: list[str]) -> None:
    """``perdure home view``."""
    flags = parse(HomeView, args, "home view")
    from perdure.home.benchmark.episodes import load_episodes
    from perdure.home.video import serve_episode

    episode = load_episodes(flags.task, flags.split)[flags.index]
    try:
        serve_episode(episode, flags.port, flags.speed, flags.seed, tell=partial(print, flush=True))
    except KeyboardInterrupt:
        print()
