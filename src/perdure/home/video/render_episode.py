"""Run one episode and show it: to a film, a sheet of pictures or a browser. The oracle acts unless others are named.

Frames are rendered from a copy of the scene that has visual geometry, see `render_scene`, so the trajectory is the same
as in the protocol.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from perdure.home.agents.oracle import Oracle
from perdure.home.agents.skill_agent import Scripted, SkillAgent
from perdure.home.benchmark.episodes import Episode
from perdure.home.evaluate.execute import Executor, ExecutorOptions
from perdure.home.evaluate.execute.executor import Running
from perdure.home.evaluate.log import EpisodeLog
from perdure.home.sim.arrays import FloatArray
from perdure.home.sim.world import Simulator, VectorSimulator
from perdure.home.skills import Skill, get_skill
from perdure.home.video.narrate import Narrator
from perdure.home.video.render_scene import put, render_scene

FrameObserver = Callable[[VectorSimulator, Simulator, Narrator], bool]
"""Called after every control step with the world, the render scene's lane and the captions. False ends the episode."""

AFTERWARDS = 45
"""Control steps that are shown after the plan has ended."""


class _StoppedError(Exception):
    """The frame observer ended the episode."""


def render_episode(
    episode: Episode,
    observe: FrameObserver,
    options: ExecutorOptions | None = None,
    agents: Mapping[str, SkillAgent] | None = None,
    skills: Mapping[str, Skill] | None = None,
) -> EpisodeLog | None:
    """Run one episode, show every step to an observer, and return its log, None when the observer ended it early.

    Args:
        episode: The episode.
        observe: Shows the frames.
        options: Evaluation seed and settings of the world; the rest is chosen here.
        agents: The agent of each skill; the oracle in all of them when None.
        skills: The skills they act in; those of the benchmark when None.
    """
    names = {step.skill for step in episode.home_task.skills}
    oracle, narrator = Oracle(), Narrator(episode)
    acting: Mapping[str, SkillAgent] = agents or {n: Scripted() if n == "reset_arm" else oracle for n in names}
    options = replace(options or ExecutorOptions(), lanes=1, threads=1, settle_steps=AFTERWARDS)

    simulator = render_scene(episode, options.eval_seed)

    def after_step(world: VectorSimulator, running: Mapping[int, Running]) -> None:
        narrator.after_step(world, running[0])
        put(simulator, world.simulator(0).qpos)
        if not observe(world, simulator, narrator):
            raise _StoppedError

    executor = Executor(skills or {name: get_skill(name) for name in names}, acting, options)
    try:
        return next(iter(executor.run([episode], after_step)))
    except _StoppedError:
        return None


def focus(world: VectorSimulator, skill: str) -> tuple[FloatArray | None, int]:
    """Return the point of the room that a skill on lane 0 is about, and the object there (-1 for none)."""
    state, skill_goal = world.sense(np.array([0])), world.skill_goal(0)
    if skill == "reset_arm":
        return None, -1
    if skill == "pick":
        return state.object[0], skill_goal.target
    if skill == "place":
        return state.goal[0], skill_goal.target
    return (state.aim[0] if skill == "navigate" else state.handle[0]), -1
