"""The hand-over: control passes from the policy to a motion of the release strategy, and back once the hand has opened.

A release strategy wraps the agent of place. When that agent commands the hand to open, it is frozen. The strategy's own
motion runs, one action per step. Then the hand opens and the agent continues. When place times out with the target
still in the hand, the executor gives the strategy time to do the same.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Generator
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from perdure.home.agents.skill_agent import LaneView, SkillAgent
from perdure.home.benchmark.tasks import AT
from perdure.home.sim.apartments import Pose
from perdure.home.sim.arrays import FloatArray, IntArray
from perdure.home.sim.world import (
    ACTION_SIZE,
    ARM,
    ARM_STEP,
    BASE_SPEED,
    FORWARD,
    GRIP,
    RELEASE,
    TURN,
    PrivilegedState,
    VectorSimulator,
)
from perdure.home.sim.world.state import norm
from perdure.home.skills import Skill, SkillProgress

Motion = Generator[FloatArray, None, None]

STILL = 0.02
"""Speed of the gripper point in [m/s] below which the hand is at rest."""
BASE_TOLERANCE = 0.01
"""Tolerance of the base pose after a stop in [m] and [rad] (OURS)."""
RETURN_RATE, RETURN_SPEED = 10.0, 0.3
"""The base returns at `RETURN_RATE` [1/s] times its error, at most at `RETURN_SPEED` in [m/s] and [rad/s] (OURS)."""
STOP_STEPS = 45
"""Step limit of a stop; then the object is released even if base and hand still move."""
NOT_ABOVE = "not above the goal"
"""Outcome without a descent: the object was released at rest, beside its goal region."""


@dataclass
class Held(LaneView):
    """One lane during its hand-over."""

    outcome: str = "done"
    """Outcome: "done", or the reason for a fall-back."""
    frozen: Pose = field(init=False)
    """Base pose when the policy was frozen."""

    def __post_init__(self) -> None:
        self.frozen = self.base

    @property
    def base_error(self) -> tuple[float, float]:
        """Displacement back to the base pose at the freeze: forward in [m], turn to the left in [rad]."""
        base, frozen = self.base, self.frozen
        forward = math.cos(base.yaw) * (frozen.x - base.x) + math.sin(base.yaw) * (frozen.y - base.y)
        return forward, math.remainder(frozen.yaw - base.yaw, math.tau)

    @property
    def above_goal(self) -> bool:
        """Whether the held object's middle is within the goal's radius of 0.15 m, seen from above."""
        offset = self.state.object[0, :2] - self.state.goal[0, :2]
        return bool(np.hypot(*offset) <= AT)

    @property
    def speed(self) -> float:
        """Speed of the gripper point in the room in [m/s]."""
        return float(norm(self.state.gripper_velocity)[0])


@dataclass
class HandOver(ABC):
    """An agent for `place` that adds a motion before the release."""

    inner: SkillAgent
    name: ClassVar[str]
    outcomes: list[str] = field(default_factory=list)
    """Outcome of each hand-over, in the order in which they ended."""
    _motions: dict[int, Motion] = field(default_factory=dict)
    _held: dict[int, Held] = field(default_factory=dict)

    @property
    def sees(self) -> bool:
        """See `SkillAgent.sees`."""
        return self.inner.sees

    @abstractmethod
    def motion(self, held: Held) -> Motion:
        """Return actions until the hand may open; the opening itself is not one of them."""

    def begin(self, world: VectorSimulator, lane: int, skill: Skill) -> None:
        """See `SkillAgent.begin`."""
        self._motions.pop(lane, None)
        self.inner.begin(world, lane, skill)

    def act(
        self, world: VectorSimulator, lanes: IntArray, skill: Skill, state: PrivilegedState, progress: SkillProgress
    ) -> FloatArray:
        """See `SkillAgent.act`."""
        actions = np.zeros((len(lanes), ACTION_SIZE))
        running = np.array([int(lane) in self._motions for lane in lanes])
        if not running.all():
            free = np.flatnonzero(~running)
            wanted = self.inner.act(world, lanes[free], skill, state[free], progress[free])
            for row, action in zip(map(int, free), wanted, strict=True):
                out_of_time = progress.elapsed[row] >= skill.limit
                if state.holds_target[row] and (action[GRIP] < 0.0 or out_of_time):
                    self._freeze(int(lanes[row]), state[row : row + 1])
                else:
                    actions[row] = action
        for row, lane in enumerate(map(int, lanes)):
            if lane in self._motions:
                actions[row] = self._continue(lane, state[row : row + 1])
        return actions

    def overtime(self, lane: int) -> bool:
        """Return whether a lane needs more time than its limit: always, to finish its hand-over."""
        return True

    def _freeze(self, lane: int, state: PrivilegedState) -> None:
        self._held[lane] = Held(state)
        self._motions[lane] = self.motion(self._held[lane])

    def _continue(self, lane: int, state: PrivilegedState) -> FloatArray:
        """Return the next action of a lane's motion; the opening of the hand when it has ended."""
        held = self._held[lane]
        held.state = state
        if state.holds_target[0]:
            try:
                return next(self._motions[lane])
            except StopIteration:
                pass
        else:
            held.outcome = "lost on the way"
        del self._motions[lane]
        self.outcomes.append(held.outcome)
        return release()


def hold_base(held: Held, arm: FloatArray | None = None) -> FloatArray:
    """Return an action that holds the base at its pose of the freeze and moves the arm by joint steps in [rad].

    The base needs about 0.2 s to stop from full speed, in which it rolls up to 0.17 m; M3's stops at once. So it
    drives back.
    """
    action = np.zeros(ACTION_SIZE)
    for part, error in zip((FORWARD, TURN), held.base_error, strict=True):
        action[part] = np.clip(RETURN_RATE * error, -RETURN_SPEED, RETURN_SPEED) / BASE_SPEED
    if arm is not None:
        action[ARM] = np.clip(arm / ARM_STEP, -1.0, 1.0)
    return action


def release() -> FloatArray:
    """Return an action that opens the hand and does nothing else."""
    action = np.zeros(ACTION_SIZE)
    action[GRIP] = RELEASE
    return action


def stop(held: Held) -> Motion:
    """Bring the base back to its pose of the freeze, the arm unmoved, until the hand is at rest."""
    for _ in range(STOP_STEPS):
        yield hold_base(held)
        if held.speed < STILL and max(map(abs, held.base_error)) < BASE_TOLERANCE:
            return


def stop_above_goal(held: Held) -> Generator[FloatArray, None, bool]:
    """Run `stop` and return whether a descent may begin; beside the goal region the outcome records why not."""
    yield from stop(held)
    if not held.above_goal:
        held.outcome = NOT_ABOVE
    return held.above_goal
