"""Films of episodes that the oracle runs, and sheets of a few pictures from one."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from perdure.home.benchmark.episodes import Episode
from perdure.home.errors import HomeError
from perdure.home.evaluate.execute import EpisodeLog, ExecutorOptions
from perdure.home.sim.world import CONTROL_HZ, Jaws, Lane, Rolling, SceneOptions, World
from perdure.home.video.cameras import Shot, check_camera
from perdure.home.video.files import Film, open_film
from perdure.home.video.follow import Follower
from perdure.home.video.marks import goal_marks
from perdure.home.video.narrate import Narrator
from perdure.home.video.render_episode import focus, render_episode
from perdure.home.video.studio import Studio
from perdure.home.video.words import write_strip

Picture = NDArray[np.uint8]
Watch = Callable[[float], None]


@dataclass(frozen=True)
class FilmOptions:
    """How a film is made."""

    camera: str = "follow"
    size: tuple[int, int] = (720, 480)
    """Width and height of the picture in pixels, without the strip below; both even."""
    speed: float = 4.0
    """How much faster than life it runs."""
    seconds: float = math.inf
    """Simulated time after which it ends, if the episode is not over before."""
    seed: int = 0
    """Evaluation seed: draws where the robot starts."""
    jaws: Jaws = "never"
    rolling: Rolling = "friction"
    """This and `jaws`: see `SceneOptions` and `ExecutorOptions`."""

    def __post_init__(self) -> None:
        """Numbers that make no film raise HomeError."""
        check_camera(self.camera)
        if not (self.speed > 0.0 and math.isfinite(self.speed)):
            raise HomeError(f"the speed of a film must be above 0, not {self.speed}")
        if not self.seconds > 0.0:
            raise HomeError(f"a film must last longer than 0 s, not {self.seconds}")
        if any(side % 2 for side in self.size):
            raise HomeError(f"width and height of a film must be even, not {self.size[0]} x {self.size[1]}")

    @property
    def executor(self) -> ExecutorOptions:
        """How the episode is run."""
        return ExecutorOptions(eval_seed=self.seed, jaws=self.jaws, scene=SceneOptions(rolling=self.rolling))


def film_episode(
    episode: Episode, path: Path, options: FilmOptions | None = None, watch: Watch = lambda seconds: None
) -> EpisodeLog | None:
    """Films the oracle at an episode.

    Args:
        episode: Which one.
        path: The film: `.mp4` or `.gif`.
        options: How.
        watch: Called with the simulated time of each picture.

    Returns:
        The episode's log, None when the film ended before the episode.
    """
    options = options or FilmOptions()
    with open_film(path) as film, ExitStack() as stack:
        crew = Crew(episode, options, film, stack, watch)
        return render_episode(episode, crew.after_step, options.executor)


class Crew:
    """Adds a picture to the film whenever one is due."""

    def __init__(self, episode: Episode, options: FilmOptions, film: Film, stack: ExitStack, watch: Watch) -> None:
        self._marks, self._options, self._film, self._stack, self._watch = (
            goal_marks(episode), options, film, stack, watch,
        )  # fmt: skip
        self._operator: _Operator | None = None
        self._pictures = self._steps = 0

    def after_step(self, world: World, double: Lane, narrator: Narrator) -> bool:
        """An `Audience`: stays until the film is long enough."""
        if self._operator is None:
            self._operator = self._stack.enter_context(_Operator(double, self._options))
        self._steps += 1
        now = self._steps / CONTROL_HZ
        while self._pictures * self._film.pace * self._options.speed <= now:
            self._film.add(self._operator.picture(world, narrator, self._film.pace))
            self._pictures += 1
            self._watch(now)
        return now < self._options.seconds


class _Operator(Studio):
    """A studio whose camera knows what the robot is about."""

    def __init__(self, lane: Lane, options: FilmOptions) -> None:
        super().__init__(lane, options.size)
        self._options_, self._follower = options, Follower(self.lane)

    def picture(self, world: World, narrator: Narrator, seconds: float) -> Picture:
        """The present moment, with its strip; `seconds` on the screen after the last one."""
        shot: str | Shot = self._options_.camera
        if shot == "follow":
            shot = self._follower.shot(*focus(world, narrator.skill), seconds=seconds)
        picture = self.take(shot, goal_marks(narrator.episode))
        return write_strip(picture, narrator.tell(), self._options_.speed)


def contact_sheet(
    episode: Episode, columns: int = 4, options: FilmOptions | None = None
) -> tuple[Picture, EpisodeLog | None]:
    """Pictures of an episode that the oracle runs, side by side: one at each stage, as it is reached.

    Args:
        episode: Which one.
        columns: How many side by side.
        options: Camera, size of one picture, seed.

    Returns:
        The sheet and the episode's log, None when `options.seconds` ended it early.

    Raises:
        HomeError: If no stage was reached.
    """
    options = options or FilmOptions(size=(480, 360), speed=1.0)
    pictures: list[Picture] = []
    with ExitStack() as stack:
        operators: list[_Operator] = []

        def after_step(world: World, double: Lane, narrator: Narrator) -> bool:
            told = narrator.tell()
            if sum(done for _, done in told.stages) > len(pictures):
                if not operators:
                    operators.append(stack.enter_context(_Operator(double, options)))
                pictures.append(operators[0].picture(world, narrator, math.inf))
            return told.seconds < options.seconds

        log = render_episode(episode, after_step, options.executor)
    if not pictures:
        raise HomeError(f"the oracle reached no stage of {episode.name}: there is nothing to show")
    return tile(pictures, columns), log


def tile(pictures: Sequence[Picture], columns: int, gap: int = 6) -> Picture:
    """Pictures of one size, row by row on white paper. Shapes (height, width, 3)."""
    height, width = pictures[0].shape[:2]
    rows = math.ceil(len(pictures) / columns)
    sheet = np.full((rows * (height + gap) - gap, columns * (width + gap) - gap, 3), 255, dtype=np.uint8)
    for k, picture in enumerate(pictures):
        y, x = (k // columns) * (height + gap), (k % columns) * (width + gap)
        sheet[y : y + height, x : x + width] = picture
    return sheet
