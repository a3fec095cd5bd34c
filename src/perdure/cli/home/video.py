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
    from perdure.errors import PerdureError
    from perdure.film import check_film, save_picture
    from perdure.home.evaluate.execute import ExecutorOptions
    from perdure.home.film import FilmOptions, contact_sheet, film_episode, make_agent
    from perdure.home.sim.scene import SceneOptions
    from perdure.home.tasks.episodes import load_episodes

    episode = load_episodes(flags.task, flags.split)[flags.index]
    executor = ExecutorOptions(eval_seed=flags.eval_seed, scene=SceneOptions(jaws=flags.jaws, rolling=flags.rolling))
    options = FilmOptions(flags.camera, flags.size, flags.speed, flags.seconds, executor)
    if flags.policies and not flags.place:
        raise PerdureError("--policies needs --place: without release strategies the oracle acts in every skill")
    if flags.out.suffix.lower() == ".png" and not flags.place:
        check_film(flags.out, (".png",))
        sheet, log = contact_sheet(episode, options)
        save_picture(sheet, flags.out, colors=256)
        _print_stages(log)
    else:
        chosen = policies(flags.policies)
        agents = [make_agent(flags.task, place, flags.train_seed, chosen, flags.vary) for place in flags.place]
        logs = film_episode(episode, flags.out, options, agents)
        for who, log in zip([f"{place}: " for place in flags.place] or [""], logs, strict=True):
            _print_stages(log, who)
    print(flags.out)


def _print_stages(log: EpisodeLog | None, who: str = "") -> None:
    """Print the number of stages reached, unless the film ended before the episode."""
    from perdure.home.evaluate.outcomes import latched

    if log is not None:
        stages = latched(log)
        print(f"{who}{sum(stages)} of {len(stages)} stages reached in {log.steps} steps")
