"""Gymnasium environments in which skills are learned. Importing this package imports gymnasium and registers them.

Contents:
    perdure/HomePick-v0, HomePlace-v0, ...  what `gymnasium.make` and `make_vec` know after the import
    HomeSkillVectorEnv, HomeSkillEnv        many lanes over one world; one lane
    LessonOptions                           their options
    register, env_id                        the names
"""

from perdure.home.gym.options import LessonOptions
from perdure.home.gym.register import env_id, register
from perdure.home.gym.single import HomeSkillEnv
from perdure.home.gym.vector import HomeSkillVectorEnv

__all__ = ["HomeSkillEnv", "HomeSkillVectorEnv", "LessonOptions", "env_id", "register"]

register()
