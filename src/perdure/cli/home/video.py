"""``perdure home video``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from perdure.cli.home.flags import parse_home, policies

if TYPE_CHECKING:
    from perdure.home.evaluate.log import EpisodeLog


@dataclass(frozen=True)
class HomeVideo:
    """Film an episode: the oracle, or several release strategies side by side. Needs no screen."""

    task: tyro.conf.Positional[str]
    """tidy_house, prepare_groceries or set_table."""
    split: str = "val"
    """val or eval."""
    index: int = 0
    """Number of the episode in its split."""
    out: Path = Path("home.mp4")
    """The film: .mp4 or .gif; .png writes a sheet with one picture for each stage."""
    camera: str = "follow"
    """follow, doll_house, plan, head or hand."""
    size: tuple[int, int] = (720, 480)
    """Width and height in pixels, even."""
    speed: float = 4.0
    """Playback speed relative to real time."""
    seconds: float = math.inf
    """Simulated time after which it ends."""
    eval_seed: int = 0
    """Draws the robot's start pose."""
    place: tuple[str, ...] = ()
    """Release strategies, side by side in one film, as for `perdure home run`; the oracle alone when there is none."""
    policies: tuple[str, ...] = ()
    """With --place: SKILL=FILE or SKILL=oracle, as for `perdure home run`."""
    train_seed: int = 0
    """With --place: training seed of the shipped policies."""
    vary: Literal["all", "place"] = "all"
    """Which skills' policies are those of the training seed: all, or place alone (the others are those of seed 0)."""
    jaws: Literal["never", "apart"] = "never"
    """As for `perdure home run`."""
    rolling: Literal["friction", "drag"] = "friction"
    """As for `perdure home run`."""


def main(args: list[str]) -> None:
    """Run ``perdure home video``."""
    flags = parse_home(HomeVideo, args, "video")
    from perdure.home.benchmark.episodes import load_episodes
    from perdure.home.errors import HomeError
    from perdure.home.video import FilmOptions, contact_sheet, film_episode, film_side_by_side, make_agent, save_picture

    episode = load_episodes(flags.task, flags.split)[flags.index]
    options = FilmOptions(
        flags.camera, flags.size, flags.speed, flags.seconds, flags.eval_seed, flags.jaws, flags.rolling
    )
    if flags.place:
        chosen = policies(flags.policies)
        agents = [make_agent(flags.task, place, flags.train_seed, chosen, flags.vary) for place in flags.place]
        for place, log in zip(flags.place, film_side_by_side(episode, flags.out, agents, options), strict=True):
            _print_stages(log, f"{place}: ")
    elif flags.policies:
        raise HomeError("--policies needs --place: without release strategies the oracle acts in every skill")
    elif flags.out.suffix.lower() == ".png":
        sheet, log = contact_sheet(episode, options=options)
        save_picture(sheet, flags.out, colors=256)
        _print_stages(log)
    else:
        _print_stages(film_episode(episode, flags.out, options))
    print(flags.out)


def _print_stages(log: EpisodeLog | None, who: str = "") -> None:
    """Print the number of stages reached, unless the film ended before the episode."""
    from perdure.home.evaluate.outcomes import latched

    if log is not None:
        stages = latched(log)
        print(f"{who}{sum(stages)} of {len(stages)} stages reached in {log.steps} steps")
