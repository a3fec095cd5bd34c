"""Films of episodes that the oracle runs, and contact sheets of a few pictures from one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from perdure.home.benchmark.episodes import Episode
from perdure.home.errors import HomeError
from perdure.home.evaluate.execute import ExecutorOptions
from perdure.home.evaluate.log import EpisodeLog
from perdure.home.sim.arrays import Picture
from perdure.home.sim.world import CONTROL_HZ, Jaws, Rolling, SceneOptions, Simulator, VectorSimulator
from perdure.home.video.cameras import Shot, check_camera
from perdure.home.video.files import Film, open_film
from perdure.home.video.follow import Follower
from perdure.home.video.marks import goal_marks
from perdure.home.video.narrate import Narrator
from perdure.home.video.render_episode import focus, render_episode
from perdure.home.video.studio import Studio
from perdure.home.video.words import write_strip

COLUMNS = 4
"""Pictures in a row of a contact sheet."""


@dataclass(frozen=True)
class FilmOptions:
    """Settings of a film."""

    camera: str = "follow"
    size: tuple[int, int] = (720, 480)
    """Width and height of the picture in pixels, without the caption strip below; both even."""
    speed: float = 4.0
    """Playback speed relative to real time."""
    seconds: float = math.inf
    """Simulated time after which the film ends, if the episode is not over before."""
    seed: int = 0
    """Evaluation seed: draws the robot's start pose."""
    jaws: Jaws = "never"
    """See `ExecutorOptions`."""
    rolling: Rolling = "friction"
    """See `SceneOptions`."""

    def __post_init__(self) -> None:
        """Raise HomeError for numbers that make no film."""
        check_camera(self.camera)
        if not (self.speed > 0.0 and math.isfinite(self.speed)):
            raise HomeError(f"the speed of a film must be above 0, not {self.speed}")
        if not self.seconds > 0.0:
            raise HomeError(f"a film must last longer than 0 s, not {self.seconds}")
        if any(side % 2 for side in self.size):
            raise HomeError(f"width and height of a film must be even, not {self.size[0]} x {self.size[1]}")

    @property
    def executor(self) -> ExecutorOptions:
        """Settings of the execution."""
        return ExecutorOptions(eval_seed=self.seed, jaws=self.jaws, scene=SceneOptions(rolling=self.rolling))


def film_episode(episode: Episode, path: Path, options: FilmOptions | None = None) -> EpisodeLog | None:
    """Film the oracle as `.mp4` or `.gif`; return the episode's log, None when the film ended before the episode."""
    options = options or FilmOptions()
    with open_film(path) as film, ExitStack() as stack:
        return render_episode(episode, FrameWriter(options, film, stack).after_step, options.executor)


class FrameWriter:
    """Adds a picture to a film whenever one is due."""

    def __init__(self, options: FilmOptions, film: Film, stack: ExitStack) -> None:
        self._options, self._film, self._stack = options, film, stack
        self._studio: _CaptionStudio | None = None
        self._pictures = self._steps = 0

    def after_step(self, world: VectorSimulator, simulator: Simulator, narrator: Narrator) -> bool:
        """Add the pictures that are due; a `FrameObserver`. False ends the film."""
        if self._studio is None:
            self._studio = self._stack.enter_context(_CaptionStudio(simulator, self._options))
        self._steps += 1
        now = self._steps / CONTROL_HZ
        while self._pictures * self._film.pace * self._options.speed <= now:
            self._film.add(self._studio.picture(world, narrator, self._film.pace))
            self._pictures += 1
        return now < self._options.seconds


class _CaptionStudio(Studio):
    """A studio whose camera follows what the skill is about, and that writes captions."""

    def __init__(self, simulator: Simulator, options: FilmOptions) -> None:
        super().__init__(simulator, options.size)
        self._film_options, self._follower = options, Follower(self.simulator)

    def picture(self, world: VectorSimulator, narrator: Narrator, seconds: float) -> Picture:
        """Return the current picture with captions; `seconds` is the time on the screen since the last one."""
        shot: str | Shot = self._film_options.camera
        if shot == "follow":
            shot = self._follower.shot(*focus(world, narrator.skill), seconds=seconds)
        picture = self.take(shot, goal_marks(narrator.episode))
        return write_strip(picture, narrator.caption(), self._film_options.speed)


def contact_sheet(episode: Episode, options: FilmOptions | None = None) -> tuple[Picture, EpisodeLog | None]:
    """Return pictures of the oracle side by side, one for each stage as it is reached, and the episode's log.

    Args:
        episode: The episode.
        options: Camera, size of one picture, seed.

    Returns:
        The sheet and the log, None when `options.seconds` ended the episode early.

    Raises:
        HomeError: If no stage was reached.
    """
    options = options or FilmOptions(size=(480, 360), speed=1.0)
    pictures: list[Picture] = []
    with ExitStack() as stack:
        studios: list[_CaptionStudio] = []

        def after_step(world: VectorSimulator, simulator: Simulator, narrator: Narrator) -> bool:
            caption = narrator.caption()
            if sum(done for _, done in caption.stages) > len(pictures):
                if not studios:
                    studios.append(stack.enter_context(_CaptionStudio(simulator, options)))
                pictures.append(studios[0].picture(world, narrator, math.inf))
            return caption.seconds < options.seconds

        log = render_episode(episode, after_step, options.executor)
    if not pictures:
        raise HomeError(f"the oracle reached no stage of {episode.name}: there is nothing to show")
    return tile(pictures, COLUMNS), log


def tile(pictures: Sequence[Picture], columns: int, gap: int = 6) -> Picture:
    """Return pictures of one size row by row on white paper. Shapes (height, width, 3)."""
    height, width = pictures[0].shape[:2]
    rows = math.ceil(len(pictures) / columns)
    sheet = np.full((rows * (height + gap) - gap, columns * (width + gap) - gap, 3), 255, dtype=np.uint8)
    for k, picture in enumerate(pictures):
        y, x = (k // columns) * (height + gap), (k % columns) * (width + gap)
        sheet[y : y + height, x : x + width] = picture
    return sheet
