"""A learned skill policy as an actor."""

from __future__ import annotations

import numpy as np

from perdure.home.agents.actor import Actor
from perdure.home.errors import HomeError
from perdure.home.sim.arrays import FloatArray, IntArray
from perdure.home.sim.world import PrivilegedState, World
from perdure.home.skills import Progress, Skill
from perdure.policy import Policy


class Learned(Actor):
    """Acts with the mean of a policy that was trained on the skill's Gymnasium environment.

    A lane's action does not depend on how many lanes act with it (see `Policy.act`).
    """

    def __init__(self, policy: Policy) -> None:
        """Keep the policy; `begin` checks that it fits the skill."""
        self.policy = policy

    def begin(self, world: World, lane: int, skill: Skill) -> None:
        """Raise HomeError for a policy whose observations or actions are not those of the skill."""
        sizes = self.policy.task.observation_size, self.policy.task.action_size
        wanted = len(skill.elements), len(skill.active_columns)
        if sizes != wanted:
            raise HomeError(
                f"the policy of {self.policy.task.name} has {sizes[0]} observations and {sizes[1]} actions; "
                f"{skill.name} has {wanted[0]} and {wanted[1]}"
            )

    def act(
        self, world: World, lanes: IntArray, skill: Skill, state: PrivilegedState, progress: Progress
    ) -> FloatArray:
        """See `Actor.act`."""
        actions = self.policy.act(skill.observe(state, progress), progress.elapsed)
        return skill.expand_action(np.asarray(actions, dtype=np.float64))
