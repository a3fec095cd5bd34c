"""Measure how fast one core of this machine steps a task, for estimates of time."""

from __future__ import annotations

import time
from collections.abc import Iterable

import numpy as np

from perdure.envs import make_world

LANES = 16
SECONDS = 2.0


def measure_speed(task: str, seconds: float = SECONDS) -> float:
    """Return lane steps a second of the bare task on one core, random actions, for about so many seconds."""
    world = make_world(task, list(range(LANES)))
    try:
        world.reset()
        low, high = (np.clip(bound, -1.0, 1.0) for bound in (world.spec.action_low, world.spec.action_high))
        actions = np.random.default_rng(0).uniform(low, high, (LANES, len(low)))
        lanes: np.ndarray[tuple[int], np.dtype[np.int64]] = np.arange(LANES)
        made, began = 0, time.perf_counter()
        while (elapsed := time.perf_counter() - began) < seconds:
            step = world.step(actions[: len(lanes)], lanes)
            made += len(lanes)
            lanes = lanes[~step.ended]
            if not len(lanes):
                world.reset()
                lanes = np.arange(LANES)
    finally:
        world.close()
    return made / elapsed


def measure_speeds(tasks: Iterable[str], seconds: float = SECONDS) -> dict[str, float]:
    """Return the speed of each task by its name."""
    return {task: measure_speed(task, seconds) for task in dict.fromkeys(tasks)}
