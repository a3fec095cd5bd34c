"""The skills of the benchmark: observation, reward, success, start states and recipe of each.

`SKILLS` has all by name; a new skill is one more entry here. `gym` makes them Gymnasium environments, `train` trains
and scores policies.
"""

from perdure.home.skills.articulated import CloseDrawer, CloseFridge, OpenDrawer, OpenFridge
from perdure.home.skills.navigate import Navigate
from perdure.home.skills.pick import Pick, ResetArm, rest_error
from perdure.home.skills.place import Place
from perdure.home.skills.registry import SKILLS, get_skill, learned_skills, make_skill_goal
from perdure.home.skills.skill import Element, Skill, SkillProgress
from perdure.home.skills.starts import Aim, region

SKILLS.update({kind.name: kind for kind in (Pick, Place, OpenDrawer, CloseDrawer)})
SKILLS.update({kind.name: kind for kind in (OpenFridge, CloseFridge, Navigate, ResetArm)})

__all__ = [
    "SKILLS",
    "Aim",
    "CloseDrawer",
    "CloseFridge",
    "Element",
    "Navigate",
    "OpenDrawer",
    "OpenFridge",
    "Pick",
    "Place",
    "ResetArm",
    "Skill",
    "SkillProgress",
    "get_skill",
    "learned_skills",
    "make_skill_goal",
    "region",
    "rest_error",
]
