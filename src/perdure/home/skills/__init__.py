"""The skills of the benchmark: observation, reward, success, start states and recipe of each.

`SKILLS` has all by name. A class that opens or closes a container is among them as soon as it is defined in
`articulated`; any other new skill is one more entry here. `gym` makes them Gymnasium environments, `train` trains
and scores policies.
"""

from perdure.home.skills.articulated import ARTICULATED, CloseDrawer, CloseFridge, OpenDrawer, OpenFridge
from perdure.home.skills.navigate import Navigate
from perdure.home.skills.pick import Pick, ResetArm, rest_error
from perdure.home.skills.place import Place
from perdure.home.skills.registry import SKILLS, get_skill, learned_skills, make_skill_goal
from perdure.home.skills.skill import Element, Skill, SkillProgress
from perdure.home.skills.starts import Aim, region

_ALL: tuple[type[Skill], ...] = (Pick, Place, *ARTICULATED.values(), Navigate, ResetArm)
SKILLS.update({kind.name: kind for kind in _ALL})

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
