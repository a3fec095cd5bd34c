"""One episode before an audience: a film camera or a browser. The oracle acts unless others are named.

It takes the course that it takes in the protocol: the audience looks at a double, see there why.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from perdure.home.agents.actor import Actor, Scripted
from perdure.home.agents.oracle import Oracle
from perdure.home.benchmark.episodes import Episode
from perdure.home.evaluate.execute.executor import Executor, ExecutorOptions
from perdure.home.evaluate.execute.log import EpisodeLog
from perdure.home.sim.world import Lane, World
from perdure.home.skills import Skill, get_skill
from perdure.home.video.narrate import Narrator
from perdure.home.video.render_scene import RenderScene

FloatArray = NDArray[np.float64]

Audience = Callable[[World, Lane, Narrator], bool]
"""Called after every control step with the world, a double of its lane that has visuals, and what is told.

The episode ends early when it returns False."""

AFTERWARDS = 45
"""Control steps that are shown after the plan has ended."""


class _EnoughError(Exception):
    """The audience has left."""


def render_episode(
    episode: Episode,
    audience: Audience,
    options: ExecutorOptions | None = None,
    actors: Mapping[str, Actor] | None = None,
    skills: Mapping[str, Skill] | None = None,
) -> EpisodeLog | None:
    """Runs one episode and shows it.

    Args:
        episode: Which one.
        audience: Who watches.
        options: Evaluation seed and settings of the world; the rest is chosen here.
        actors: Who acts in which skill; the oracle in all of them when None.
        skills: The skills they act in; those of the benchmark when None.

    Returns:
        The episode's log, None when the audience left early.
    """
    names = {step.skill for step in episode.home_task.skills}
    oracle = Oracle()
    cast: Mapping[str, Actor] = actors or {n: Scripted() if n == "reset_arm" else oracle for n in names}
    narrator = Narrator(episode)
    options = replace(options or ExecutorOptions(), lanes=1, threads=1, settle_steps=AFTERWARDS)

    def watch(world: World, episodes: Mapping[int, Episode]) -> None:
        narrator.after_step(world)
        double.put(world.lane(0).qpos)
        if not audience(world, double.lane, narrator):
            raise _EnoughError

    executor = Executor(skills or {name: get_skill(name) for name in names}, narrator.hear(cast), options)
    with RenderScene(episode, options.eval_seed) as double:
        try:
            return next(iter(executor.run([episode], watch)))
        except _EnoughError:
            return None


def focus(world: World, skill: str) -> tuple[FloatArray | None, int]:
    """What a skill is about on lane 0: a point of the room, and the number of the object there (-1 for none)."""
    state, skill_goal = world.sense(np.array([0])), world.skill_goal(0)
    if skill == "reset_arm":
        return None, -1
    if skill == "pick":
        return state.object[0], skill_goal.target
    if skill == "place":
        return state.goal[0], skill_goal.target
    return (state.aim[0] if skill == "navigate" else state.handle[0]), -1
