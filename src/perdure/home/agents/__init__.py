"""Agents: learned policies, the oracle and release strategies.

Contents:
    SkillAgent         the interface: actions for some lanes at a time
    Scripted      skills that bring their own motion
    Learned       a policy of perdure
    Predicting    a policy of any library, as a function
    oracle        a scripted agent that knows the whole simulated state
    release       release strategies: what happens between the policy's command to open the hand and the opening
"""

from perdure.home.agents.learned import Learned
from perdure.home.agents.predicting import Predicting
from perdure.home.agents.skill_agent import Scripted, SkillAgent

__all__ = ["Learned", "Predicting", "Scripted", "SkillAgent"]
