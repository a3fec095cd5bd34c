"""A learned skill policy as an agent."""

from __future__ import annotations

import numpy as np

from perdure.home.agents.skill_agent import SkillAgent
from perdure.home.errors import HomeError
from perdure.home.sim.arrays import FloatArray, IntArray
from perdure.home.sim.world import PrivilegedState, VectorSimulator
from perdure.home.skills import Skill, SkillProgress
from perdure.policy import Policy


class Learned(SkillAgent):
    """Acts with the mean of a policy that was trained on the skill's Gymnasium environment.

    A lane's action does not depend on how many lanes act with it (see `Policy.act`).
    """

    def __init__(self, policy: Policy) -> None:
        """Keep the policy; `begin` checks that it fits the skill."""
        self.policy = policy

    def begin(self, world: VectorSimulator, lane: int, skill: Skill) -> None:
        """Raise HomeError for a policy whose observations or actions are not those of the skill."""
        sizes = self.policy.task.observation_size, self.policy.task.action_size
        wanted = len(skill.elements), len(skill.active_columns)
        if sizes != wanted:
            raise HomeError(
                f"the policy of {self.policy.task.name} has {sizes[0]} observations and {sizes[1]} actions; "
                f"{skill.name} has {wanted[0]} and {wanted[1]}"
            )
        from perdure.home.skills.gym.register import PREFIX, env_id

        trained = self.policy.task.name.partition(",")[0]  # options follow; another maker's policy may have any name
        if trained.startswith(PREFIX) and trained != env_id(skill.name):
            raise HomeError(f"the policy of {trained} was trained for another skill than {skill.name}")

    def act(
        self, world: VectorSimulator, lanes: IntArray, skill: Skill, state: PrivilegedState, progress: SkillProgress
    ) -> FloatArray:
        """See `SkillAgent.act`."""
        actions = self.policy.act(skill.observe(state, progress), progress.elapsed)
        return skill.expand_action(np.asarray(actions, dtype=np.float64))
