"""Release strategies: what the robot does between the command to open the hand and the opening.

A `HandOver` wraps the agent of place. When that agent commands the hand to open, it is frozen. The motion of the
release strategy runs, one action per step. Then the hand opens and the agent continues. When place times out with the
target still in the hand, the executor gives the strategy time to do the same.

`ReleaseStrategy` is a vocabulary (`perdure.registry`): `perdure home run --place NAME` finds each of its classes.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from perdure.errors import lookup
from perdure.home.agents.learned import LaneView, Motion, SkillAgent
from perdure.home.sim.arrays import FloatArray, IntArray
from perdure.home.sim.kinematics import gripper_pose, reach, toward
from perdure.home.sim.pieces import Pose
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.scene import CONTROL_HZ
from perdure.home.sim.sensors import PrivilegedState, norm
from perdure.home.sim.simulator import ARM_STEP, BASE_SPEED, RELEASE
from perdure.home.sim.vector_simulator import VectorSimulator
from perdure.home.skills import Skill, SkillProgress
from perdure.home.tasks.tasks import AT
from perdure.registry import Registered

STILL = 0.02
"""Speed of the gripper point in [m/s] below which the hand is at rest."""
BASE_TOLERANCE = 0.01
"""Tolerance of the base pose after a stop in [m] and [rad] (our choice)."""
RETURN_RATE = 10.0
RETURN_SPEED = 0.3
"""The base returns at `RETURN_RATE` [1/s] times its error, at most at `RETURN_SPEED` in [m/s] and [rad/s] (our
choice)."""
STOP_STEPS = 45
"""Step limit of a stop; then the object is released even if base and hand still move."""
NOT_ABOVE = "not above the goal"
"""Outcome without a descent: the object was released at rest, beside its goal region."""


@dataclass
class HandOverView(LaneView):
    """One lane during its hand-over."""

    base_speed: float = BASE_SPEED
    """Speed of a base action of 1 in [m/s] and [rad/s]."""
    outcome: str = "done"
    """Outcome: "done", or the reason for a fall-back."""
    frozen: Pose = field(init=False)
    """Base pose when the policy was frozen."""

    def __post_init__(self) -> None:
        self.frozen = self.base

    @property
    def base_error(self) -> tuple[float, float]:
        """Displacement back to the base pose at the freeze: forward in [m], turn to the left in [rad]."""
        base = self.base
        frozen = self.frozen
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


class ReleaseStrategy(Registered):
    """What the robot does between the command to open the hand and the opening; subclasses are frozen dataclasses."""

    words: ClassVar[str]
    """What it does, for tables and figures: "stop first"."""

    @abstractmethod
    def motion(self, view: HandOverView) -> Motion:
        """Return actions until the hand may open; the opening itself is not one of them."""

    def around(self, inner: SkillAgent) -> SkillAgent:
        """Return an agent for `place` that acts as another one and releases by this strategy."""
        return HandOver(inner, self)


@dataclass
class HandOver:
    """An agent for `place` that adds the motion of a release strategy before the release."""

    inner: SkillAgent
    strategy: ReleaseStrategy
    outcomes: list[str] = field(default_factory=list)
    """Outcome of each hand-over, in the order in which they ended."""
    _motions: dict[int, Motion] = field(default_factory=dict)
    _views: dict[int, HandOverView] = field(default_factory=dict)

    @property
    def needs_scan(self) -> bool:
        """See `SkillAgent.needs_scan`."""
        return self.inner.needs_scan

    @property
    def is_oracle(self) -> bool:
        """See `SkillAgent.is_oracle`."""
        return self.inner.is_oracle

    def begin(self, world: VectorSimulator, lane: int, skill: Skill) -> None:
        """See `SkillAgent.begin`."""
        self._motions.pop(lane, None)
        self.inner.begin(world, lane, skill)

    def act(
        self, world: VectorSimulator, lanes: IntArray, skill: Skill, state: PrivilegedState, progress: SkillProgress
    ) -> FloatArray:
        """See `SkillAgent.act`."""
        actions = np.zeros((len(lanes), ROBOT.action_size))
        running = np.array([int(lane) in self._motions for lane in lanes])
        if not running.all():
            free = np.flatnonzero(~running)
            wanted = self.inner.act(world, lanes[free], skill, state[free], progress[free])
            for row, action in zip(map(int, free), wanted, strict=True):
                out_of_time = progress.elapsed[row] >= skill.limit
                if state.holds_target[row] and (action[ROBOT.action.grip] < 0.0 or out_of_time):
                    lane = int(lanes[row])
                    view = HandOverView(state[row : row + 1], world.simulator(lane).base_speed(skill.base_speed))
                    self._views[lane] = view
                    self._motions[lane] = self.strategy.motion(view)
                else:
                    actions[row] = action
        for row, lane in enumerate(map(int, lanes)):
            if lane in self._motions:
                actions[row] = self._continue(lane, state[row : row + 1])
        return actions

    def overtime(self, lane: int) -> bool:
        """Return whether a lane needs more time than its limit: always, to finish its hand-over."""
        return True

    def _continue(self, lane: int, state: PrivilegedState) -> FloatArray:
        """Return the next action of a lane's motion; the opening of the hand when it has ended."""
        view = self._views[lane]
        view.state = state
        if not state.holds_target[0]:
            view.outcome = "lost on the way"
        elif (action := next(self._motions[lane], None)) is not None:
            return action
        del self._motions[lane]
        self.outcomes.append(view.outcome)
        action = np.zeros(ROBOT.action_size)
        action[ROBOT.action.grip] = RELEASE
        return action


def hold_base(view: HandOverView, arm: FloatArray | None = None) -> FloatArray:
    """Return an action that holds the base at its pose of the freeze and moves the arm by joint steps in [rad].

    The base needs about 0.2 s to stop from full speed, in which it rolls up to 0.17 m; M3's stops at once. So it
    drives back.
    """
    action = np.zeros(ROBOT.action_size)
    for part, error in zip((ROBOT.action.forward, ROBOT.action.turn), view.base_error, strict=True):
        action[part] = np.clip(RETURN_RATE * error, -RETURN_SPEED, RETURN_SPEED) / view.base_speed
    if arm is not None:
        action[ROBOT.action.arm] = np.clip(arm / ARM_STEP, -1.0, 1.0)
    return action


def stop(view: HandOverView) -> Motion:
    """Bring the base back to its pose of the freeze, the arm unmoved, until the hand is at rest."""
    for _ in range(STOP_STEPS):
        yield hold_base(view)
        if view.speed < STILL and max(map(abs, view.base_error)) < BASE_TOLERANCE:
            return


def stop_above_goal(view: HandOverView) -> Generator[FloatArray, None, bool]:
    """Run `stop` and return whether a descent may begin; beside the goal region the outcome records why not."""
    yield from stop(view)
    if not view.above_goal:
        view.outcome = NOT_ABOVE
    return view.above_goal


@dataclass(frozen=True)
class AtOnce(ReleaseStrategy):
    """The hand opens at once, in motion: the agent of place itself, without a hand-over."""

    name = "rl"
    words = "open at once"

    def motion(self, view: HandOverView) -> Motion:
        """See `ReleaseStrategy.motion`."""
        yield from ()

    def around(self, inner: SkillAgent) -> SkillAgent:
        """Return the agent as it is."""
        return inner


@dataclass(frozen=True)
class Stop(ReleaseStrategy):
    """The base returns to its pose of the freeze; when the hand is at rest it opens."""

    name = "stop"
    words = "stop first"

    def motion(self, view: HandOverView) -> Motion:
        """See `ReleaseStrategy.motion`."""
        yield from stop(view)


EPSILON = 0.05
"""Depth of the descent in [m]."""
SPEED = 0.15
"""Speed of the descent in [m/s]."""
OUT_OF_REACH = 0.02
"""Largest error in [m] of a reached end point; beyond it the point counts as out of reach."""


@dataclass(frozen=True)
class Ik(ReleaseStrategy):
    """The end effector goes from (x, y, z) to (x, y, z - epsilon) by inverse kinematics (thesis, section 2.2).

    The thesis assumes that (x, y, z) is directly above the goal region; here it is checked. When it is not (outcome
    "not above the goal"), or (x, y, z - epsilon) is out of reach ("out of reach"), the object is released where the
    stop ended. When an obstacle ends the descent early (the servos lag), it is released there ("blocked").
    """

    name = "ik"
    words = "stop, lower 5 cm"

    epsilon: float = EPSILON
    """Depth of the descent in [m]."""

    def motion(self, view: HandOverView) -> Motion:
        """See `ReleaseStrategy.motion`."""
        if not (yield from stop_above_goal(view)):
            return
        start = view.state.gripper_in_base[0].copy()
        rotation = view.state.gripper_rotation[0].copy()
        end = start - (0.0, 0.0, self.epsilon)
        if reach(end, rotation, view.arm)[1] > OUT_OF_REACH:
            view.outcome = "out of reach"
            return
        for wanted in descent(start, self.epsilon):
            yield follow(view, wanted, rotation)
        yield from stop(view)
        if np.linalg.norm(view.state.gripper_in_base[0] - end) > OUT_OF_REACH:
            view.outcome = "blocked"


DEEPEST = 0.25
"""Largest depth of a guarded descent in [m]."""
LAG = 0.005
"""Height in [m] of the gripper point above where its servos' targets would put it that counts as a contact (our choice:
a free descent lags by less than 2 mm)."""


@dataclass(frozen=True)
class Guarded(ReleaseStrategy):
    """Descent until the hand lags behind its servos' targets: a guarded move, which feels contact by joint encoders.

    Then the targets return to where the hand is, so that it does not press on the object that it releases. Outcomes
    besides "done": "no contact" within 0.25 m or the arm's reach, "not above the goal" (read from the simulator).
    """

    name = "guarded"
    words = "stop, lower to contact"

    def motion(self, view: HandOverView) -> Motion:
        """See `ReleaseStrategy.motion`."""
        if not (yield from stop_above_goal(view)):
            return
        start = view.state.gripper_in_base[0].copy()
        rotation = view.state.gripper_rotation[0].copy()
        view.outcome = "no contact"
        for wanted in descent(start, DEEPEST):
            if lag(view) > LAG:
                view.outcome = "done"
                yield follow(view, view.state.gripper_in_base[0], rotation)
                break
            if np.linalg.norm(wanted - gripper_pose(ROBOT.torso_height, view.arm)[0]) > OUT_OF_REACH:
                break
            yield follow(view, wanted, rotation)
        yield from stop(view)


def descent(start: FloatArray, depth: float) -> Iterator[FloatArray]:
    """Yield points in the base frame straight below `start`, one for each control step. Shape (3,)."""
    for step in range(1, int(np.ceil(depth * CONTROL_HZ / SPEED)) + 1):
        yield start - (0.0, 0.0, min(step * SPEED / CONTROL_HZ, depth))


def follow(view: HandOverView, point: FloatArray, rotation: FloatArray) -> FloatArray:
    """Return an action that holds the base and brings the servos' targets to a gripper point in the base frame.

    From where the targets would put the gripper: what the arm lags behind is not made up for.
    """
    return hold_base(view, toward(view.arm, point - gripper_pose(ROBOT.torso_height, view.arm)[0], rotation=rotation))


def lag(view: HandOverView) -> float:
    """Return how far the gripper point is above where its servos' targets would put it in [m]."""
    return float(view.state.gripper_in_base[0, 2] - gripper_pose(ROBOT.torso_height, view.arm)[0][2])


def release_strategy(name: str) -> ReleaseStrategy:
    """Return the release strategy of a name; PerdureError when there is none."""
    return lookup(ReleaseStrategy.kinds(), name, "release strategy")()


def make_strategy(name: str, inner: SkillAgent) -> SkillAgent:
    """Return an agent for place that acts as another one and releases by the strategy of that name."""
    return release_strategy(name).around(inner)
