"""A top-down drawing of an episode: the apartment, what lies where, and where the targets belong."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from perdure.home.benchmark.episodes.records import Episode
from perdure.home.benchmark.tasks import AT
from perdure.home.sim.apartments import draw_apartment

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TARGETS = ("#1f5f8b", "#8b3a62", "#2f7d4f", "#b5651d", "#5b4b8a")
_CLUTTER = "#8a857c"


def draw_episode(episode: Episode, axes: Axes) -> None:
    """Draws an episode into matplotlib axes: clutter grey, each target a dot, a line to its goal, the goal's circle."""
    from matplotlib.patches import Circle

    draw_apartment(episode.apartment(), axes, episode.opened)
    for k, placement in enumerate(episode.objects):
        color = _TARGETS[k] if k < len(episode.goals) else _CLUTTER
        axes.add_patch(Circle(placement.position[:2], 0.05, facecolor=color, edgecolor="white", lw=0.4, zorder=9))
    for k, (start, goal) in enumerate(zip(episode.objects, episode.goals, strict=False)):
        axes.plot(*zip(start.position[:2], goal.position[:2], strict=True), color=_TARGETS[k], lw=0.8, zorder=8)
        axes.add_patch(Circle(goal.position[:2], AT, fill=False, edgecolor=_TARGETS[k], lw=1.2, zorder=9))
    axes.set_title(f"{episode.name} ({episode.apartment().name})", fontsize=9)


def save_episode_plan(episode: Episode, path: str | Path) -> None:
    """Writes the drawing of one episode as a picture file (PNG, SVG or PDF by its ending)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 5.0), layout="constrained")
    draw_episode(episode, figure.add_subplot())
    figure.savefig(path, dpi=150)
