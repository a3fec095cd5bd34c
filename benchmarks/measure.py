"""Our side of the benchmarks, run as a process of its own so that it can be pinned to cores: prints one JSON line.

python benchmarks/measure.py train TASK SEEDS ITERATIONS PROCESSES
python benchmarks/measure.py evaluate TASK LANES STEPS
python benchmarks/measure.py floors TASK
"""

from __future__ import annotations

import dataclasses
import json
import sys
import tempfile
import time
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from perdure.envs import Step, make_world

if TYPE_CHECKING:
    from perdure.ppo import PPOConfig


def train(task: str, seeds: int, iterations: int, processes: int) -> dict[str, float]:
    """Environment steps a second, all processes together, from the end of each seed's second iteration on.

    A number of seeds that the processes share evenly keeps each of them busy beside the others.
    """
    from perdure.ppo import TrainRun, method_config, on_report, train

    world = make_world(task, [0])
    size = world.spec.observation_size
    world.close()
    config = method_config("ppo", task, size)
    steps = config.rollout_size * iterations
    config = dataclasses.replace(config, total_steps=steps, segment_steps=steps)
    marks: dict[int, list[tuple[int, float]]] = {seed: [] for seed in range(seeds)}
    run = TrainRun(task, "ppo", config, tuple(marks))
    observe = on_report(run, lambda report: marks[report.seed].append((report.step, time.perf_counter())))
    with tempfile.TemporaryDirectory() as out:
        train(run, out, cores=processes, on="here" if processes == 1 else "local", observe=observe)
    rates = [(last - first) / (ended - began) for (_, (first, began), *_, (last, ended)) in marks.values()]
    return {"steps_per_second": float(np.mean(rates)) * processes}


class Recording:
    """A world that remembers what it was asked to do."""

    def __init__(self, task: str, seeds: list[int]) -> None:
        self._world = make_world(task, seeds)
        self.log: list[tuple[np.ndarray, np.ndarray]] = []
        self.spec, self.num_lanes = self._world.spec, self._world.num_lanes
        self.reset, self.close = self._world.reset, self._world.close

    def step(self, actions: np.ndarray, lanes: np.ndarray) -> Step:
        self.log.append((actions, lanes.astype(np.int32)))
        return self._world.step(actions, lanes)


def evaluate(task: str, lanes: int, steps: int) -> dict[str, float]:
    """Lane steps a second of our closed loop, and of the engine alone fed with the same actions, in turn."""
    import envpool

    from perdure.extrapolate import LaneSpec, evaluate_lanes
    from perdure.extrapolate.lanes import FIRST_EVAL_SEED
    from perdure.policy import load_policy
    from perdure.policy.shipped import find_policy

    policy = load_policy(find_policy(f"{task}/geometric"))
    specs = [LaneSpec(0, policy.clock, seed) for seed in range(lanes)]
    seeds = [FIRST_EVAL_SEED + seed for seed in range(lanes)]
    recording = Recording(task, seeds)
    evaluate_lanes([policy], specs, steps, world=recording)
    recording.close()
    made = sum(len(ids) for _, ids in recording.log)
    ours, engine = [], []
    for _ in range(3):
        world = make_world(task, seeds)  # before the clock runs, as the engine's below
        began = time.perf_counter()
        evaluate_lanes([policy], specs, steps, world=world)
        ours.append(made / (time.perf_counter() - began))
        world.close()
        pool = envpool.make(
            task, env_type="gymnasium", num_envs=lanes, num_threads=1, seed=seeds, max_episode_steps=10**9
        )
        pool.reset()
        send, receive = pool._send, pool._recv  # EnvPool's Python wrapper left out: this is the engine at its fastest
        began = time.perf_counter()
        for actions, ids in recording.log:
            send([ids, ids, actions])
            receive()
        engine.append(made / (time.perf_counter() - began))
    return {"ours": float(np.median(ours)), "engine": float(np.median(engine)), "lane_steps": made}


def engine_step(task: str, steps: int = 5000) -> float:
    """Seconds of one step of one environment, its own resets included."""
    import envpool

    pool = envpool.make(task, env_type="gymnasium", num_envs=1, num_threads=1, seed=0)
    rng, lane = np.random.default_rng(0), np.zeros(1, np.int32)
    actions = rng.uniform(-1, 1, (steps, 1, *pool.action_space.shape))
    pool.reset()
    began = time.perf_counter()
    for action in actions:
        pool._send([lane, lane, action])
        pool._recv()
    return (time.perf_counter() - began) / steps


def products(config: PPOConfig, inputs: int, actions: int, repeats: int = 300) -> float:
    """Seconds of the matrix products of learning, for each environment step."""
    rng = np.random.default_rng(0)

    def random(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape, np.float32)

    layers = []
    for outputs in (actions, 1):
        for layer, (a, b) in enumerate(pairwise((inputs, *config.hidden_sizes, outputs))):
            x, weight, error = random(config.batch_size, a), random(a, b), random(config.batch_size, b)
            layers.append((layer, x, weight, error))
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


def floors(task: str) -> dict[str, float]:
    """Microseconds of an environment step that training cannot do without."""
    from perdure.ppo import method_config

    world = make_world(task, [0])
    spec = world.spec
    world.close()
    config = method_config("ppo", task, spec.observation_size)
    learn = products(config, spec.observation_size, spec.action_size)
    return {"engine": 1e6 * engine_step(task), "products": 1e6 * learn}


if __name__ == "__main__":
    kind, task, *numbers = sys.argv[1:]
    print(json.dumps({"train": train, "evaluate": evaluate, "floors": floors}[kind](task, *(int(n) for n in numbers))))
