"""Agents that act in skills: their interface, learned policies, functions, and the scripted `reset_arm`."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Generator
from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from perdure.envs.suites import parse_options
from perdure.errors import PerdureError
from perdure.home.sim.arrays import FloatArray, IntArray
from perdure.home.sim.pieces import Pose
from perdure.home.sim.sensors import PrivilegedState
from perdure.home.sim.vector_simulator import VectorSimulator
from perdure.home.skills import ResetArm, Skill, SkillProgress
from perdure.home.skills.registry import PREFIX, env_id
from perdure.horizon import Clock, Countdown
from perdure.policy import Policy


class SkillAgent(Protocol):
    """Acts for some lanes at a time. What it remembers of a lane, it keeps under the lane's number.

    Subclasses inherit all but `act`. Any class with these members is an agent.
    """

    @property
    def needs_scan(self) -> bool:
        """Whether it needs the scan and the target's neighbors, where the skill has them."""
        return True

    @property
    def is_oracle(self) -> bool:
        """Whether the oracle acts, so that logs count its skills as scripted."""
        return False

    def begin(self, world: VectorSimulator, lane: int, skill: Skill) -> None:
        """Prepare a lane for a skill; its skill goal is set."""
        return

    @abstractmethod
    def act(
        self, world: VectorSimulator, lanes: IntArray, skill: Skill, state: PrivilegedState, progress: SkillProgress
    ) -> FloatArray:
        """Return actions for these lanes, rows of `state` and `progress`. Shape (len(lanes), action size)."""

    def overtime(self, lane: int) -> bool:
        """Return whether a lane needs more time than the skill's limit, to put down what it holds."""
        return False


Motion = Generator[FloatArray, None, None]
"""Actions of one lane, one for each control step. Shape (action size,)."""


@dataclass
class LaneView:
    """One lane during a motion; `state` (one row) is updated before each action."""

    state: PrivilegedState

    @property
    def base(self) -> Pose:
        """Base pose."""
        x, y, yaw = self.state.base[0].tolist()
        return Pose(x, y, yaw)

    @property
    def arm(self) -> FloatArray:
        """Targets of the arm's servos in [rad]. Shape (joints,)."""
        return np.asarray(self.state.arm_target[0])


class Scripted(SkillAgent):
    """Acts in skills that bring their own motion (`reset_arm`)."""

    needs_scan = False

    def act(
        self, world: VectorSimulator, lanes: IntArray, skill: Skill, state: PrivilegedState, progress: SkillProgress
    ) -> FloatArray:
        """See `SkillAgent.act`."""
        assert isinstance(skill, ResetArm)
        return skill.act(state)


class Learned(SkillAgent):
    """Acts with the mean of a policy that was trained on the skill's Gymnasium environment.

    A lane's action does not depend on how many lanes act with it (see `Policy.act`).
    """

    def __init__(self, policy: Policy, clock: Clock | None = None) -> None:
        """Keep the policy; `check_fits` says whether it fits a skill.

        `clock` sets a time-to-go input; when None it counts down from the skill's step limit.
        """
        self.policy = policy
        self.clock = clock

    def begin(self, world: VectorSimulator, lane: int, skill: Skill) -> None:
        """See `check_fits`."""
        self.check_fits(skill)

    def check_fits(self, skill: Skill) -> None:
        """Raise PerdureError for a policy of another skill, of other options, observations or actions."""
        trained, _, given = self.policy.task.name.partition(",")
        if trained.startswith(PREFIX):  # another maker's policy may have any name
            if trained != env_id(skill.name):
                raise PerdureError(f"the policy of {trained} was trained for another skill than {skill.name}")
            options = parse_options(given)
            for each in fields(skill):
                theirs = options.get(each.name, each.default)
                ours = getattr(skill, each.name)
                if theirs != ours:
                    raise PerdureError(
                        f"the policy was trained with {each.name}={theirs}, not {ours}: use another --place"
                    )
        sizes = (self.policy.task.observation_size, self.policy.task.action_size)
        wanted = (len(skill.elements), skill.action_size)
        if sizes != wanted:
            raise PerdureError(
                f"the policy of {self.policy.task.name} has {sizes[0]} observations and {sizes[1]} actions; "
                f"{skill.name} has {wanted[0]} and {wanted[1]}"
            )

    def act(
        self, world: VectorSimulator, lanes: IntArray, skill: Skill, state: PrivilegedState, progress: SkillProgress
    ) -> FloatArray:
        """See `SkillAgent.act`."""
        clock = self.clock or (Countdown(skill.limit) if self.policy.has_clock else None)
        actions = self.policy.act(skill.observe(state, progress), progress.elapsed, clock)
        return skill.expand_action(np.asarray(actions, dtype=np.float64), state)


class Predicting(SkillAgent):
    """Acts with a function, such as another library's policy, in any one skill.

    Observations and actions are those of the skill's Gymnasium environment. A policy with memory needs its own
    `SkillAgent`. Lanes are independent if the rows of the function are.
    """

    def __init__(self, predict: Callable[[FloatArray], ArrayLike]) -> None:
        """Keep the function.

        Args:
            predict: Observations, shape (n, observation size), to actions, shape (n, action size of the skill).
                Values outside -1 to 1 are clipped. n changes from call to call.
        """
        self.predict = predict

    def act(
        self, world: VectorSimulator, lanes: IntArray, skill: Skill, state: PrivilegedState, progress: SkillProgress
    ) -> FloatArray:
        """See `SkillAgent.act`. PerdureError if the function returns a wrong shape."""
        actions = np.asarray(self.predict(skill.observe(state, progress)), dtype=np.float64)
        shape = (len(lanes), skill.action_size)
        if actions.shape != shape:
            raise PerdureError(f"predict gave actions of shape {actions.shape} for {skill.name}; it must be {shape}")
        return skill.expand_action(actions, state)
