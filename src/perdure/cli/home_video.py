"""``perdure home video``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from perdure.cli.parse import parse, policies

if TYPE_CHECKING:
    from perdure.home.evaluate.execute import EpisodeLog


@dataclass(frozen=True)
class HomeVideo:
    """Film an episode, without a screen: the oracle, or several placing arms side by side."""

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
    place: tuple[str, ...] = ()
    """Placing arms, side by side in one film, as for `perdure home run`; the oracle alone when there is none."""
    policies: tuple[str, ...] = ()
    """With --place: SKILL=FILE or SKILL=oracle, as for `perdure home run`."""
    train_seed: int = 0
    """With --place: which of the shipped policies."""
    vary: Literal["all", "place"] = "all"
    """Whose policy is that of the training seed: every skill's, or that of place alone (the others are of seed 0)."""
    jaws: Literal["never", "apart"] = "never"
    """As for `perdure home run`."""
    rolling: Literal["friction", "drag"] = "friction"
    """As for `perdure home run`."""


def main(args: list[str]) -> None:
    """``perdure home video``."""
    flags = parse(HomeVideo, args, "home video")
    from perdure.home.benchmark.episodes import load_episodes
    from perdure.home.errors import HomeError
    from perdure.home.video import FilmOptions, contact_sheet, film_beside, film_episode, make_take, save_picture

    episode = load_episodes(flags.task, flags.split)[flags.index]
    options = FilmOptions(flags.camera, flags.size, flags.speed, flags.seconds, flags.seed, flags.jaws, flags.rolling)
    if flags.place:
        chosen = policies(flags.policies)
        takes = [make_take(flags.task, place, flags.train_seed, chosen, flags.vary) for place in flags.place]
        for place, log in zip(flags.place, film_beside(episode, flags.out, takes, options), strict=True):
            _tell(log, f"{place}: ")
    elif flags.policies:
        raise HomeError("policies act in a film of placing arms: name some with --place")
    elif flags.out.suffix.lower() == ".png":
        sheet, log = contact_sheet(episode, options=options)
        save_picture(sheet, flags.out, colors=256)
        _tell(log)
    else:
        _tell(film_episode(episode, flags.out, options))
    print(flags.out)


def _tell(log: EpisodeLog | None, who: str = "") -> None:
    """How far the episode went, if the film did not end before it."""
    if log is not None:
        print(f"{who}{sum(log.latched)} of {len(log.latched)} stages reached in {log.steps} steps")
