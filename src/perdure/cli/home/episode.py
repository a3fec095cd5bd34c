"""``perdure home episode``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from perdure.cli.home.flags import parse_home


@dataclass(frozen=True)
class HomeEpisode:
    """Show where the objects of an episode start, and the goals of its targets."""

    task: tyro.conf.Positional[str]
    """tidy_house, prepare_groceries or set_table."""
    split: str = "val"
    """val (new arrangements of known apartments) or eval (new apartments)."""
    index: int = 0
    """Number of the episode in its split."""
    eval_seed: int = 0
    """Draws the robot's start pose."""
    render: Path | None = None
    """Also render it into this PNG file."""
    camera: str = "doll_house"
    """doll_house, plan, follow, head or hand."""
    size: tuple[int, int] = (900, 600)
    """Width and height of the picture in pixels."""


def main(args: list[str]) -> None:
    """Run ``perdure home episode``."""
    flags = parse_home(HomeEpisode, args, "episode")
    from rich.console import Console
    from rich.table import Table

    from perdure.home.tasks.episodes import episode_hash, load_episodes, start_pose

    episode = load_episodes(flags.task, flags.split)[flags.index]
    apartment = episode.apartment()
    pose = start_pose(apartment, episode, flags.eval_seed)
    print(f"{episode.name} in {apartment.name}, hash {episode_hash(episode)}")
    print(f"robot at ({pose.x:.2f}, {pose.y:.2f}) m, heading {pose.yaw:.2f} rad (evaluation seed {flags.eval_seed})")
    opened = ", ".join(f"{link} {value:.2f}" for link, value in episode.opened.items())
    print(f"open at the start: {opened or 'nothing'}")
    table = Table("", "object", "lies on", "in", "at [m]", "belongs on", "at [m]", box=None, pad_edge=False)
    for column in table.columns:
        column.no_wrap = True
    for number, placement in enumerate(episode.objects):
        place = placement.receptacle.split("|")[0]
        row = [placement.kind, place, "", _point(placement.position), "", ""]
        if number < len(episode.goals):
            goal = episode.goals[number]
            row[2:] = [episode.container(number) or "", row[3], goal.receptacle.split("|")[0], _point(goal.position)]
        table.add_row(str(number) if number < len(episode.goals) else "", *row)
    Console(width=140, markup=False).print(table)
    if flags.render is not None:
        from perdure.film import save_picture
        from perdure.home.pictures import Studio, goal_marks, render_scene

        with Studio(render_scene(episode, flags.eval_seed), flags.size) as studio:
            print(save_picture(studio.take(flags.camera, goal_marks(episode)), flags.render))


def _point(position: tuple[float, float, float]) -> str:
    return " ".join(f"{value:.2f}" for value in position)
