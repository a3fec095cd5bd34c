"""Our side of the home benchmarks, as a process of its own: prints one JSON line.

python benchmarks/measure_home.py scene      full SetTable scenes while the oracle manipulates
python benchmarks/measure_home.py place      the place skill's environment
python benchmarks/measure_home.py tasks      task plans on SetTable, policies included

Acting is recorded first and played again for the clock, so that `scene` and `place` time the world alone. Both say,
too, which share of that time is spent inside MuJoCo's `mj_step`.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Sequence
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

import numpy as np

from perdure.home.agents import Scripted
from perdure.home.agents.oracle import Oracle
from perdure.home.benchmark.episodes import Episode, episode_scene, load_episodes, start_pose
from perdure.home.evaluate.execute import Executor, ExecutorOptions
from perdure.home.evaluate.outcomes import read_logs
from perdure.home.evaluate.protocol import EvaluationProtocol, choose_policies, run_protocol
from perdure.home.sim.world import CONTROL_HZ, PHYSICS_HZ, VectorSimulator
from perdure.home.skills import get_skill
from perdure.home.skills.gym import HomeSkillVectorEnv

REPEATS = 3
LANES = 12
PLACE_LANES = 64
"""Environments side by side: with 16, a control step cost a third more."""
MANIPULATION = ("pick", "place", "open_drawer", "close_drawer", "open_fridge", "close_fridge")


class Engine:
    """MuJoCo's `mj_step` as the lanes call it, with a clock around it."""

    def __init__(self) -> None:
        import mujoco

        self.spent, self._step = 0.0, mujoco.mj_step
        mujoco.mj_step = self

    def __call__(self, *args: Any) -> None:
        began = time.perf_counter()
        self._step(*args)
        self.spent += time.perf_counter() - began


class Recording(VectorSimulator):
    """A simulator that records the actions of every step."""

    log: ClassVar[list[tuple[np.ndarray, ...]]] = []

    def step(self, *arguments: Any) -> None:
        self.log.append(tuple(np.array(each) for each in arguments))
        super().step(*arguments)


def scene() -> dict[str, float]:
    """Lane steps a second: full scenes, all collisions, where at least half of the lanes manipulate."""
    import perdure.home.evaluate.execute.executor as executor_module

    episodes = load_episodes("set_table", "val").episodes[:LANES]
    skills = {step.skill: get_skill(step.skill) for step in episodes[0].home_task.skills}
    oracle = Oracle()
    agents = {name: Scripted() if name == "reset_arm" else oracle for name in skills}
    executor_module.VectorSimulator = Recording  # type: ignore[misc]
    logs = list(Executor(skills, agents, ExecutorOptions(lanes=LANES, threads=1)).run(episodes))
    manipulates = np.zeros(len(Recording.log))
    for log in logs:
        for done in log.runs:
            manipulates[done.begin : done.end] += done.skill in MANIPULATION
    sizes = np.array([len(lanes) for _, lanes, _, _ in Recording.log])
    return _replay(episodes, manipulates >= 0.5 * sizes)


def _replay(episodes: Sequence[Episode], timed: np.ndarray) -> dict[str, float]:
    engine, runs = Engine(), []
    for _ in range(REPEATS):
        world = VectorSimulator(LANES, threads=1)
        for lane, episode in enumerate(episodes):
            built = episode_scene(episode)
            world.reset(lane, built, start_pose(built.apartment, episode, 0))
        spent, steps, inside = 0.0, 0, 0.0
        for (actions, lanes, speed, arm_step), counts in zip(Recording.log, timed, strict=True):
            began, engine.spent = time.perf_counter(), 0.0
            world.step(actions, lanes, speed, arm_step)
            world.sense(lanes)
            if counts:
                spent, steps, inside = spent + time.perf_counter() - began, steps + len(lanes), inside + engine.spent
        runs.append((steps / spent, inside / spent))
    return _best(runs)


def _best(runs: Sequence[tuple[float, float]]) -> dict[str, float]:
    rate, share = max(runs)
    return {"control_steps_per_second": rate, "engine_share": share}


def place() -> dict[str, float]:
    """Control steps a second of the place environment at the evaluation's physics rate, resets included."""
    policies = choose_policies("set_table", 0)
    env = HomeSkillVectorEnv(
        PLACE_LANES, skill="place", task="set_table", split="val", physics_hz=PHYSICS_HZ, threads=1
    )
    policy = policies["place"].policy
    rng = np.random.default_rng(0)
    actions: list[np.ndarray] = []

    def act(observations: np.ndarray) -> np.ndarray:
        if policy is None:
            return rng.uniform(-0.3, 0.3, env.action_space.shape)
        return np.asarray(policy.act(observations, np.zeros(env.num_envs)), dtype=np.float64)

    engine, runs = Engine(), []
    for turn in range(REPEATS):
        observations, _ = env.reset(seed=0)
        spent, steps, engine.spent = 0.0, 200, 0.0
        for k in range(steps):
            if turn == 0:
                actions.append(act(observations))
            began = time.perf_counter()
            observations, _, terminated, truncated, info = env.step(actions[k])
            over = terminated | truncated | (info["elapsed"] >= env.skill.limit)
            if over.any():
                observations, _ = env.reset(options={"reset_mask": over})
            spent += time.perf_counter() - began
        if turn:  # the first one builds the scenes
            runs.append((steps * env.num_envs / spent, engine.spent / spent))
    return _best(runs)


def tasks() -> dict[str, float]:
    """Control steps a second of SetTable's 100 val episodes from start to end, as `perdure home run set_table` does it.

    On all cores of this process; the policies (or the oracle), the building of scenes and the logs included.
    """
    cores = len(os.sched_getaffinity(0))
    with TemporaryDirectory() as out:
        began = time.perf_counter()
        paths = run_protocol(EvaluationProtocol("set_table"), out, on="local", cores=cores)
        spent = time.perf_counter() - began
        steps = sum(record.length for path in paths for record in read_logs(path))
    return {"control_steps_per_second": steps / spent}


if __name__ == "__main__":
    result = {"scene": scene, "place": place, "tasks": tasks}[sys.argv[1]]()
    print(json.dumps({**result, "control_hz": CONTROL_HZ, "physics_hz": PHYSICS_HZ}))
