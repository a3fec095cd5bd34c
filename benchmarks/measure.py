"""Measure perdure in a process of its own, so that it can be pinned to cores; print one JSON line.

python benchmarks/measure.py train TASK[@PRESET] ITERATIONS         environment steps a second
python benchmarks/measure.py evaluate TASK LANES STEPS               lane steps a second, and those of EnvPool alone
python benchmarks/measure.py floors TASK                             seconds of a step that no program can do without
python benchmarks/measure.py home place|tasks                        control steps a second of the home world
python benchmarks/measure.py robot CONTRACT                          control steps a second of a robot, and of `mj_step`

home place   the place skill's environment; acting is recorded first and played again for the clock, so that this times
             the world alone, and gives the share of that time that MuJoCo's `mj_step` takes
home tasks   task plans on SetTable, policies included
"""

from __future__ import annotations

import dataclasses
import json
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

REPEATS = 3
PLACE_LANES = 64
"""Side by side: with 16, a control step of the place environment cost a third more."""


def train(setting: str, iterations: int) -> dict[str, float]:
    """Environment steps a second of one seed, from the end of its second iteration on."""
    from perdure.envs import task_spec
    from perdure.learn import TrainRun, method_config, on_report, train

    task, _, preset = setting.partition("@")
    config = method_config("ppo", task, task_spec(task).observation_size, preset or "zoo")
    steps = config.rollout_size * iterations
    config = dataclasses.replace(config, total_steps=steps, segment_steps=steps)
    marks: list[tuple[int, float]] = []
    run = TrainRun(task, "ppo", config, preset=preset or "zoo")
    observe = on_report(run, lambda report: marks.append((report.step, time.perf_counter())))
    with tempfile.TemporaryDirectory() as out:
        train(run, out, on="here", observe=observe)
    _, (first, began), *_, (last, ended) = marks
    return {"steps_per_second": (last - first) / (ended - began)}


class Recording:
    """A world that records the actions of every step."""

    def __init__(self, world: Any) -> None:
        self._world = world
        self.log: list[tuple[np.ndarray, np.ndarray]] = []
        self.spec = world.spec
        self.num_lanes = world.num_lanes
        self.reset = world.reset
        self.close = world.close

    def step(self, actions: np.ndarray, lanes: np.ndarray) -> Any:
        self.log.append((actions, lanes.astype(np.int32)))
        return self._world.step(actions, lanes)


def engine_seconds(task: str, seeds: list[int], steps: Sequence[tuple[np.ndarray, np.ndarray]]) -> float:
    """Seconds that EnvPool alone takes for actions of lanes. Its Python wrapper is left out: its fastest form."""
    import envpool

    limits = {}
    if len(seeds) > 1:
        limits["max_episode_steps"] = 10**9
    pool = envpool.make(task, env_type="gymnasium", num_envs=len(seeds), num_threads=1, seed=seeds, **limits)
    pool.reset()
    began = time.perf_counter()
    for actions, lanes in steps:
        pool._send([lanes, lanes, actions])
        pool._recv()
    return time.perf_counter() - began


def evaluate(task: str, lanes: int, steps: int) -> dict[str, float]:
    """Lane steps a second of our closed loop, and of the engine alone fed with the same actions, in turn."""
    from perdure.envs import make_world
    from perdure.evaluate import EpisodeSpec, evaluate_episodes
    from perdure.evaluate.episodes import FIRST_EVAL_SEED
    from perdure.policy import load_policy

    policy = load_policy(f"{task}/geometric")
    specs = [EpisodeSpec(0, policy.clock, seed, steps=steps) for seed in range(lanes)]
    seeds = [FIRST_EVAL_SEED + seed for seed in range(lanes)]
    recording = Recording(make_world(task, seeds))
    evaluate_episodes([policy], specs, world=recording)
    recording.close()
    made = sum(len(ids) for _, ids in recording.log)
    ours = []
    engine = []
    for _ in range(REPEATS):
        world = make_world(task, seeds)  # before the clock runs, as the engine's
        began = time.perf_counter()
        evaluate_episodes([policy], specs, world=world)
        ours.append(made / (time.perf_counter() - began))
        world.close()
        engine.append(made / engine_seconds(task, seeds, recording.log))
    return {"ours": float(np.median(ours)), "engine": float(np.median(engine))}


def products(config: Any, inputs: int, actions: int, repeats: int = 300) -> float:
    """Seconds of the matrix products of learning, for each environment step."""
    rng = np.random.default_rng(0)

    def random(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape, np.float32)

    layers = []
    for outputs in (actions, 1):
        for layer, (a, b) in enumerate(pairwise((inputs, *config.hidden_sizes, outputs))):
            layers.append((layer, random(config.batch_size, a), random(a, b), random(config.batch_size, b)))
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        for layer, x, weight, error in layers:
            x @ weight
            x.T @ error
            if layer:  # the gradient of the inputs is not asked for
                error @ weight.T
        times.append(time.perf_counter() - began)
    return float(np.median(times)) * config.n_epochs / config.batch_size


def floors(task: str, steps: int = 5000) -> dict[str, float]:
    """Seconds of one step of one environment in EnvPool, its resets included, and of the products for it."""
    from perdure.envs import task_spec
    from perdure.learn import method_config

    spec = task_spec(task)
    config = method_config("ppo", task, spec.observation_size, "zoo")
    actions = np.random.default_rng(0).uniform(-1, 1, (steps, 1, spec.action_size))
    lane = np.zeros(1, np.int32)
    engine = engine_seconds(task, [0], [(action, lane) for action in actions]) / steps
    return {"engine": engine, "products": products(config, spec.observation_size, spec.action_size)}


class Engine:
    """MuJoCo's `mj_step` as the lanes call it, with a clock around it."""

    def __init__(self) -> None:
        import mujoco

        self.spent = 0.0
        self._step = mujoco.mj_step
        mujoco.mj_step = self

    def __call__(self, *args: Any) -> None:
        began = time.perf_counter()
        self._step(*args)
        self.spent += time.perf_counter() - began


def place(steps: int = 200) -> dict[str, float]:
    """Control steps a second of the place environment at the evaluation's physics rate, resets included."""
    from perdure.home.evaluate.policies import choose_policies
    from perdure.home.sim.scene import PHYSICS_HZ
    from perdure.home.skills.environment import HomeSkillVectorEnv

    env = HomeSkillVectorEnv(
        PLACE_LANES, skill="place", task="set_table", split="val", physics_hz=PHYSICS_HZ, threads=1
    )
    policy = choose_policies("set_table", 0)["place"].policy
    assert policy is not None
    actions: list[np.ndarray] = []
    engine = Engine()
    runs = []
    for turn in range(REPEATS):
        observations, _ = env.reset(seed=0)
        spent = 0.0
        engine.spent = 0.0
        for k in range(steps):
            if turn == 0:
                actions.append(np.asarray(policy.act(observations, np.zeros(env.num_envs)), dtype=np.float64))
            began = time.perf_counter()
            observations, _, terminated, truncated, info = env.step(actions[k])
            over = terminated | truncated | (info["elapsed"] >= env.skill.limit)
            if over.any():
                observations, _ = env.reset(options={"reset_mask": over})
            spent += time.perf_counter() - began
        if turn:  # the first one builds the scenes
            runs.append((steps * env.num_envs / spent, engine.spent / spent))
    return dict(zip(("control_steps_per_second", "engine_share"), max(runs), strict=True))


def tasks() -> dict[str, float]:
    """Control steps a second of SetTable's 100 val episodes from start to end, as `perdure home run set_table` does it.

    On all cores of this process; the policies, the building of scenes and the logs included.
    """
    from perdure.home.evaluate.files import read_logs
    from perdure.home.evaluate.protocol import EvaluationProtocol, run_protocol

    with tempfile.TemporaryDirectory() as out:
        began = time.perf_counter()
        paths = run_protocol(EvaluationProtocol("set_table"), out, on="local", cores=len(os.sched_getaffinity(0)))
        spent = time.perf_counter() - began
        steps = sum(sum(log.length for log in read_logs(path)) for path in paths)
        return {"control_steps_per_second": steps / spent}


def home(what: str) -> dict[str, float]:
    """See the module."""
    from perdure.home.sim.scene import CONTROL_HZ

    found = {"place": place, "tasks": tasks}[what]()
    return {**found, "simulated_per_second": found["control_steps_per_second"] / CONTROL_HZ}


def robot(contract: str, steps: int = 2000) -> dict[str, float]:
    """Control steps a second of a robot's environment, and of `mj_step` under the same controls, in turn."""
    import mujoco

    from perdure.robots.world import VelocityCommandEnv

    env = VelocityCommandEnv(contract)
    rates: dict[str, list[float]] = {"ours": [], "engine": []}
    actions = 0.3 * np.random.default_rng(0).standard_normal((steps, env.model.nu))
    controls = env.contract.values("default_pose") + env.contract.values("action_scale") * actions
    for name in [*rates] * REPEATS:
        env.reset(seed=0)
        began = time.perf_counter()
        for action, control in zip(actions, controls, strict=True):
            if name == "ours":
                env.step(action)
            else:
                env.data.ctrl[:] = control
                mujoco.mj_step(env.model, env.data, nstep=env.frame_skip)
        rates[name].append(steps / (time.perf_counter() - began))
    return {name: max(found) for name, found in rates.items()}


MEASUREMENTS: dict[str, Any] = {each.__name__: each for each in (robot, train, evaluate, floors, home)}

if __name__ == "__main__":
    kind, *words = sys.argv[1:]
    arguments = [int(word) if word.isdigit() else word for word in words]
    print(json.dumps(MEASUREMENTS[kind](*arguments)))
