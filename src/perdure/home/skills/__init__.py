"""The skills of the benchmark, one file each: observation, reward, success, start states, recipe, documentation.

Contents:
    SKILLS, get_skill        the skills by name; a new skill is one more line here
    Skill, SkillProgress     the interface; per-episode state
    Element, ObservationTerm, Recipe
    Aim, region              where navigation should end
    make_skill_goal          the goal of a plan's step
    gym, training            Gymnasium environments; training and scores
"""

from perdure.home.skills.articulated import Articulated
from perdure.home.skills.close_drawer import CloseDrawer
from perdure.home.skills.close_fridge import CloseFridge
from perdure.home.skills.navigate import Navigate
from perdure.home.skills.observation import Element, ObservationTerm
from perdure.home.skills.open_drawer import OpenDrawer
from perdure.home.skills.open_fridge import OpenFridge
from perdure.home.skills.pick import Pick
from perdure.home.skills.place import Place
from perdure.home.skills.progress import SkillProgress
from perdure.home.skills.recipe import Recipe
from perdure.home.skills.regions import Aim, region
from perdure.home.skills.registry import SKILLS, get_skill, learned_skills, make_skill_goal
from perdure.home.skills.reset_arm import ResetArm, rest_error
from perdure.home.skills.skill import Skill

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
