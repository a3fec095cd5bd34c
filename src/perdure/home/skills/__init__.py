"""The skills of the benchmark, one file each: observation, reward, success, start states, recipe, documentation.

Contents:
    SKILLS, get_skill        the skills by name; a new skill is one more line here
    Skill, SkillProgress     the interface; per-episode state
    Element, ObservationTerm, Recipe
    Aim, region              where navigation should end
    make_skill_goal          the goal of a plan's step
    gym, training            Gymnasium environments; training and scores
"""

from perdure.home.skills.articulated import Articulated, CloseDrawer, CloseFridge, OpenDrawer, OpenFridge
from perdure.home.skills.navigate import Navigate
from perdure.home.skills.pick import Pick, ResetArm, rest_error
from perdure.home.skills.place import Place
from perdure.home.skills.registry import SKILLS, get_skill, learned_skills, make_skill_goal
from perdure.home.skills.skill import Aim, Element, ObservationTerm, Recipe, Skill, SkillProgress, region

SKILLS["pick"] = Pick
SKILLS["place"] = Place
SKILLS["open_drawer"] = OpenDrawer
SKILLS["close_drawer"] = CloseDrawer
SKILLS["open_fridge"] = OpenFridge
SKILLS["close_fridge"] = CloseFridge
SKILLS["navigate"] = Navigate
SKILLS["reset_arm"] = ResetArm

__all__ = [
    "SKILLS",
    "Aim",
    "Articulated",
    "CloseDrawer",
    "CloseFridge",
    "Element",
    "Navigate",
    "ObservationTerm",
    "OpenDrawer",
    "OpenFridge",
    "Pick",
    "Place",
    "Recipe",
    "ResetArm",
    "Skill",
    "SkillProgress",
    "get_skill",
    "learned_skills",
    "make_skill_goal",
    "region",
    "rest_error",
]
