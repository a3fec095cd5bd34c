"""The same episode under several placing arms, side by side in one film."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from perdure.home.agents.actor import Actor
from perdure.home.benchmark.episodes import Episode
from perdure.home.benchmark.tasks import SkillName
from perdure.home.evaluate.execute.log import EpisodeLog
from perdure.home.evaluate.protocol import Protocol, make_actors
from perdure.home.evaluate.protocol.policies import SkillPolicy
from perdure.home.evaluate.protocol.protocol import Vary
from perdure.home.skills import Skill
from perdure.home.video.files import open_film
from perdure.home.video.film import Crew, FilmOptions, Watch
from perdure.home.video.reel import Reel
from perdure.home.video.render_episode import render_episode
from perdure.home.video.words import write_title

Picture = NDArray[np.uint8]

GAP = 8
"""Between two pictures, in pixels; even, as films want it."""
WORDS = {
    "rl": "lets go when the policy wants to",
    "stop": "stands still, lets go",
    "ik": "stands still, lowers by 5 cm, lets go",
    "ik+": "stands still, turns upright, lowers until it feels contact, lets go",
}


@dataclass(frozen=True)
class Take:
    """One half of the film: who acts, and what is written over it."""

    title: str
    """Such as `ik: stands still, lowers by 5 cm, lets go`."""
    caption: str
    """Who acts in which skill."""
    actors: Mapping[str, Actor]
    skills: Mapping[str, Skill]


def make_take(
    task: str, place: str, train_seed: int = 0, policies: Mapping[str, str] | None = None, vary: Vary = "all"
) -> Take:
    """What acts under a placing arm.

    Args:
        task: Name of the task.
        place: See `perdure.home.evaluate.protocol.placing`.
        train_seed: Of the shipped policies.
        policies: Skill to file or "oracle", see `choose_policies`: else shipped policies, else the oracle.
        vary: Whose policy is that of the training seed, see `Protocol`.

    Raises:
        HomeError: If the arm, a skill or a file is none.
    """
    protocol = Protocol(task, place, episodes=1, vary=vary, policies=policies or {})
    chosen = protocol.assignment(train_seed)
    words = WORDS.get(place, f"trained to make objects stay for {protocol.placing.delta} steps")
    return Take(f"{place}: {words}", caption(chosen), make_actors(chosen, protocol.placing.arm), protocol.skills())


def caption(chosen: Mapping[SkillName, SkillPolicy]) -> str:
    """Who acts, in a few words."""
    learned = [skill for skill, each in chosen.items() if each.policy is not None]
    if not learned:
        return "the scripted oracle acts in every skill: there is no learned policy for any"
    if len(learned) == len(chosen):
        return "learned policies act in every skill"
    return f"learned: {', '.join(learned)}; the scripted oracle acts in the other skills"


def film_beside(
    episode: Episode,
    path: Path,
    takes: Sequence[Take],
    options: FilmOptions | None = None,
    watch: Watch = lambda seconds: None,
) -> list[EpisodeLog | None]:
    """Films one episode under several arms; those that end before the longest hold their last picture.

    Args:
        episode: Which one.
        path: The film: `.mp4` or `.gif`.
        takes: From left to right.
        options: How; the size is that of one of them.
        watch: Called with the simulated time of each picture.

    Returns:
        A log for each take, None where the film ended before the episode.
    """
    options, logs = options or FilmOptions(), []
    with open_film(path) as film, ExitStack() as stack:
        reels = [stack.enter_context(Reel(film.pace)) for _ in takes]
        for take, reel in zip(takes, reels, strict=True):
            with ExitStack() as studio:
                crew = Crew(episode, options, reel, studio, watch)
                logs.append(render_episode(episode, crew.after_step, options.executor, take.actors, take.skills))
        for number in range(max(map(len, reels))):
            film.add(_side_by_side([_half(*each, number) for each in zip(takes, reels, strict=True)]))
    return logs


def _side_by_side(pictures: Sequence[Picture]) -> Picture:
    """Pictures of one size with a gap between them. Shapes (height, width, 3)."""
    gap = np.full((len(pictures[0]), GAP, 3), 255, dtype=np.uint8)
    parts = [part for picture in pictures for part in (gap, picture)]
    return np.concatenate(parts[1:], axis=1)


def _half(take: Take, reel: Reel, number: int) -> Picture:
    ended = " (ended)" if number >= len(reel) else ""
    return write_title(reel.picture(number), f"{take.title}{ended}", take.caption)
