"""The worlds that the contract is tested on: a sample of every suite, and for `make verify` every registered task."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from counting import factories
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from perdure.envs import World, list_tasks, make_world
from perdure.envs.gymnasium import GymnasiumWorld
from perdure.envs.vector_env import VectorEnvWorld

SAMPLE = {
    "Hopper-v3",
    "Humanoid-v5",
    "InvertedPendulum-v2",
    "CheetahRun-v1",
    "HandReach-v3",
    "HandManipulateBlock_ContinuousTouchSensors-v1",
    "perdure/HomePlace-v0",
}
KEPT_HIGH = {"perdure/HomePlace-v0": -1}
"""Which action is always the highest where a random one ends the episode at once: an opened hand drops the object."""


@dataclass(frozen=True)
class Case:
    """One way to build a world from seeds."""

    name: str
    build: Callable[[Sequence[int]], World]


def counting_world(seeds: Sequence[int], **options: Any) -> GymnasiumWorld:
    return GymnasiumWorld(factories(len(seeds), **options), seeds)


def counting_vector(seeds: Sequence[int], mode: AutoresetMode, **options: Any) -> VectorEnvWorld:
    return VectorEnvWorld(SyncVectorEnv(factories(len(seeds), **options), autoreset_mode=mode), seeds)


def _task(name: str) -> Case:
    # A home task would first make a pool of training episodes.
    options = ",split=val,episodes=8" if name.startswith("perdure/Home") else ""
    return Case(name, lambda seeds: make_world(name + options, seeds))


def _all_cases() -> list[Any]:
    names = [listing.name for listing in list_tasks() if not listing.name.startswith("gymnasium:")]
    cases = [pytest.param(_task(name), id=name, marks=[] if name in SAMPLE else pytest.mark.verify) for name in names]
    cases += [pytest.param(_task(name), id=name) for name in ("gymnasium:Pendulum-v1", "gymnasium:Hopper-v5")]
    counting = Case("counting", lambda seeds: counting_world(seeds, one_memory=True))
    falling = Case("falling", lambda seeds: counting_world(seeds, falls_after=4))
    cases += [pytest.param(case, id=case.name) for case in (counting, falling)]
    for mode in AutoresetMode:

        def build(seeds: Sequence[int], mode: AutoresetMode = mode) -> World:
            return counting_vector(seeds, mode, falls_after=4)

        cases.append(pytest.param(Case(f"vector-{mode.name}", build), id=f"vector-{mode.name}"))
    return cases


CASES = _all_cases()
"""For what depends on the task."""
SAMPLE_CASES = [case for case in CASES if not case.marks]
"""For what is decided before a task is touched."""


def actions_of(seed: int, world: World, steps: int) -> np.ndarray:
    """A lane's actions, shape (steps, action_size): they follow the seed, wherever its lane lies."""
    spec = world.spec
    low, high = 0.5 * spec.action_low, 0.5 * spec.action_high
    actions = np.random.default_rng(seed).uniform(low, high, (steps, spec.action_size))
    if (kept := KEPT_HIGH.get(spec.name.partition(",")[0])) is not None:
        actions[:, kept] = spec.action_high[kept]
    return actions


def trajectories(
    world: World, seeds: Sequence[int], steps: int, order: Sequence[int] | None = None
) -> list[np.ndarray]:
    """Steps every lane `steps` times, resetting each where it ends.

    Returns per lane one row per event (reset or step): observation, reward, terminated, truncated.
    """
    order = list(range(len(seeds))) if order is None else list(order)
    plans = [actions_of(seed, world, steps) for seed in seeds]
    rows: list[list[np.ndarray]] = [[np.append(first, [0.0, 0.0, 0.0])] for first in world.reset()]
    for k in range(steps):
        result = world.step(np.stack([plans[lane][k] for lane in order]), np.array(order))
        for row, lane in enumerate(order):
            ends = [result.rewards[row], result.terminated[row], result.truncated[row]]
            rows[lane].append(np.append(result.observations[row], ends))
        ended = np.array(order)[result.ended]
        if len(ended):
            for lane, first in zip(ended, world.reset(ended), strict=True):
                rows[lane].append(np.append(first, [0.0, 0.0, 0.0]))
    return [np.stack(lane) for lane in rows]
