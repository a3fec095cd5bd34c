"""Replay a judged episode with access to its simulation."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from perdure.envs import GymnasiumWorld
from perdure.extrapolate.film.errors import FilmError
from perdure.extrapolate.film.judge import JudgedLane
from perdure.extrapolate.film.render_env import RenderEnv
from perdure.extrapolate.lanes import FIRST_EVAL_SEED
from perdure.policy import ClosedLoop, LanePolicy, Policy
from perdure.policy.one_thread import one_thread


@dataclass(frozen=True, eq=False)
class Instant:
    """The episode after a step."""

    step: int
    reward: float
    total: float
    """Return so far; steps after the end do not count."""
    env: Any
    """The environment in the state after this step."""


def replay(policy: Policy, lane: JudgedLane, render_env: RenderEnv, stop: int) -> Iterator[Instant]:
    """Yield each step of a judged episode, and of what the robot does after its end, up to step ``stop``.

    Raises:
        FilmError: If the episode is not the one that was judged.
    """
    env = render_env.build()
    world = GymnasiumWorld([lambda: env], [FIRST_EVAL_SEED + lane.eval_seed])
    try:
        with one_thread():
            loop = ClosedLoop(world, [LanePolicy(policy, lane.clock)])
            total = 0.0
            for step in range(1, min(stop, lane.end_step) + 1):
                result = loop.advance().step
                total += float(result.rewards[0])
                if bool(result.terminated[0]) != (step == lane.end_step and lane.outcome == "falls"):
                    raise FilmError(f"the episode of start state {lane.eval_seed} is not the one that was judged")
                yield Instant(step, float(result.rewards[0]), total, env)
            if stop >= lane.end_step and lane.outcome != "diverges" and not math.isclose(total, lane.total):
                raise FilmError(f"the episode returned {total:.6g} when it was filmed and {lane.total:.6g} when judged")
            yield from _afterwards(policy, lane, env, result.observations, range(lane.end_step + 1, stop + 1), total)
    finally:
        world.close()


def _afterwards(
    policy: Policy, lane: JudgedLane, env: Any, observations: Any, steps: range, total: float
) -> Iterator[Instant]:
    """Yield further steps of the policy after the end, which do not count."""
    for step in steps:
        elapsed = np.array([step - 1.0])
        action = policy.act(observations, elapsed, lane.clock)[0]
        space = env.action_space
        observation, reward, *_ = env.step(action.reshape(space.shape).astype(space.dtype))
        observations = np.asarray(observation, np.float64)[None]
        yield Instant(step, float(reward), total, env)
