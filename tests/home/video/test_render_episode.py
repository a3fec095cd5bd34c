"""Rendering does not change an episode: its trajectory is that of an execution without frames."""

import numpy as np
import pytest

from perdure.home.agents import Scripted
from perdure.home.agents.oracle import Oracle
from perdure.home.benchmark.episodes import load_episodes
from perdure.home.evaluate.execute import Executor, ExecutorOptions
from perdure.home.sim.world import SceneOptions
from perdure.home.skills import get_skill
from perdure.home.video.render_episode import render_episode

STEPS = 260
"""Until the first object is in the hand."""
SCENE = SceneOptions(rolling="drag")


class EnoughError(Exception):
    pass


def test_a_frame_observer_changes_nothing():
    episode = load_episodes("set_table", "val")[5]
    shown, seen = [], []

    def observe(world, lane, narrator):
        shown.append(world.simulator(0).qpos.copy())
        assert np.array_equal(lane.qpos, shown[-1])
        assert lane.model.ngeom > world.simulator(0).model.ngeom
        seen.append(lane.data.site("gripper").xpos.copy())
        return len(shown) < STEPS

    assert render_episode(episode, observe, ExecutorOptions(eval_seed=1, scene=SCENE)) is None

    alone = []

    def watch(world, episodes):
        alone.append(world.simulator(0).qpos.copy())
        np.testing.assert_allclose(seen[len(alone) - 1], world.simulator(0).data.site("gripper").xpos, atol=1e-9)
        if len(alone) == STEPS:
            raise EnoughError

    names = {step.skill for step in episode.home_task.skills}
    oracle = Oracle()
    executor = Executor(
        {name: get_skill(name) for name in names},
        {name: Scripted() if name == "reset_arm" else oracle for name in names},
        ExecutorOptions(eval_seed=1, lanes=1, threads=1, scene=SCENE),
    )
    with pytest.raises(EnoughError):
        next(executor.run([episode], watch))
    assert np.array_equal(shown, alone)
