"""Training and scores of skills.

Contents:
    skill_recipe, skill_config       a skill's recipe; PPO's settings made from it
    FLAGS                            environment options that are flags of `perdure home train`
    train_skill                      train a skill
    evaluate_skill, SkillScore       success rate from fresh start states
"""

from perdure.home.skills.training.evaluate import SkillScore, evaluate_skill
from perdure.home.skills.training.train import FLAGS, skill_config, skill_recipe, train_skill

__all__ = ["FLAGS", "SkillScore", "evaluate_skill", "skill_config", "skill_recipe", "train_skill"]
