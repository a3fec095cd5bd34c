"""Learning the skills: settings of each, and how good a policy is.

Contents:
    evaluate_skill, SkillScore    success from fresh starts
"""

from perdure.home.training.evaluate import SkillScore, evaluate_skill

__all__ = ["SkillScore", "evaluate_skill"]
