"""Learning the skills: settings of each, and how good a policy is.

Contents:
    RECIPES, Recipe, skill_config    PPO's settings for each skill
    FLAGS                            options that change what is learned
    train_skill                      trains one
    evaluate_skill, SkillScore       success from fresh starts
"""

from perdure.home.skills.training.evaluate import SkillScore, evaluate_skill
from perdure.home.skills.training.recipes import FLAGS, RECIPES, Recipe, skill_config, skill_task, train_skill

__all__ = [
    "FLAGS",
    "RECIPES",
    "Recipe",
    "SkillScore",
    "evaluate_skill",
    "skill_config",
    "skill_task",
    "train_skill",
]
