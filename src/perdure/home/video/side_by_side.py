"""The same episode under several release strategies, side by side in one film."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from perdure.home.agents.skill_agent import SkillAgent
from perdure.home.benchmark.episodes import Episode
from perdure.home.benchmark.tasks import SkillName
from perdure.home.evaluate.log import EpisodeLog
from perdure.home.evaluate.page.words import describe
from perdure.home.evaluate.protocol import EvaluationProtocol, make_agents
from perdure.home.evaluate.protocol.policies import SkillPolicy
from perdure.home.evaluate.protocol.protocol import Vary
from perdure.home.sim.arrays import Picture
from perdure.home.skills import Skill
from perdure.home.video.files import open_film
from perdure.home.video.film import FilmOptions, FrameWriter, tile
from perdure.home.video.frame_buffer import FrameBuffer
from perdure.home.video.render_episode import render_episode
from perdure.home.video.words import write_title

GAP = 8
"""Between two pictures, in pixels; even, as films need it."""


@dataclass(frozen=True)
class Agent:
    """Policies for all skills and a release strategy, with the texts written over its film."""

    title: str
    """Such as `ik: stop, lower 5 cm`."""
    caption: str
    """Where learned policies act and where the oracle does."""
    skill_agents: Mapping[str, SkillAgent]
    skills: Mapping[str, Skill]


def make_agent(
    task: str, place: str, train_seed: int = 0, policies: Mapping[str, str] | None = None, vary: Vary = "all"
) -> Agent:
    """Return the agent of a release strategy.

    Args:
        task: Name of the task.
        place: Release strategy, see `perdure.home.evaluate.protocol.read_release`.
        train_seed: Of the shipped policies.
        policies: Skill to file or "oracle", see `choose_policies`; else shipped policies, else the oracle.
        vary: Which policies are those of the training seed, see `EvaluationProtocol`.

    Raises:
        HomeError: If strategy, skill or file do not exist.
    """
    protocol = EvaluationProtocol(task, place, episodes=1, vary=vary, policies=policies or {})
    chosen = protocol.assignment(train_seed)
    skill_agents = make_agents(chosen, protocol.release.strategy)
    return Agent(f"{place}: {describe(place)}", _caption(chosen), skill_agents, protocol.skills())


def _caption(chosen: Mapping[SkillName, SkillPolicy]) -> str:
    learned = [skill for skill, each in chosen.items() if each.policy is not None]
    if not learned:
        return "the scripted oracle acts in every skill: there is no learned policy for any"
    if len(learned) == len(chosen):
        return "learned policies act in every skill"
    return f"learned: {', '.join(learned)}; the scripted oracle acts in the other skills"


def film_side_by_side(
    episode: Episode, path: Path, agents: Sequence[Agent], options: FilmOptions | None = None
) -> list[EpisodeLog | None]:
    """Film one episode under several agents; those that end early hold their last picture.

    Args:
        episode: The episode.
        path: The film: `.mp4` or `.gif`.
        agents: From left to right.
        options: Settings; the size is that of one agent's picture.

    Returns:
        A log for each agent, None where the film ended before the episode.
    """
    options, logs = options or FilmOptions(), []
    with open_film(path) as film, ExitStack() as stack:
        buffers = [stack.enter_context(FrameBuffer(film.pace)) for _ in agents]
        for agent, frames in zip(agents, buffers, strict=True):
            with ExitStack() as studio:
                writer = FrameWriter(options, frames, studio)
                logs.append(
                    render_episode(episode, writer.after_step, options.executor, agent.skill_agents, agent.skills)
                )
        for number in range(max(map(len, buffers))):
            panels = [_panel(*each, number) for each in zip(agents, buffers, strict=True)]
            film.add(tile(panels, len(panels), GAP))
    return logs


def _panel(agent: Agent, frames: FrameBuffer, number: int) -> Picture:
    ended = " (ended)" if number >= len(frames) else ""
    return write_title(frames.picture(number), f"{agent.title}{ended}", agent.caption)
