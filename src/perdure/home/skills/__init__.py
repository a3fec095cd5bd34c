"""The skills of the benchmark as pure functions over `PrivilegedState`, one file each.

Contents:
    get_skill, SKILLS        by name
    Skill, Progress, Element what a skill is
    Pick, Place, OpenDrawer, CloseDrawer, OpenFridge, CloseFridge, Navigate, ResetArm
    region, Aim              where navigation should end
"""

from typing import Any

from perdure.home.errors import HomeError
from perdure.home.skills.articulated import Articulated, holds_handle
from perdure.home.skills.close_drawer import CloseDrawer
from perdure.home.skills.close_fridge import CloseFridge
from perdure.home.skills.navigate import Navigate
from perdure.home.skills.open_drawer import OpenDrawer
from perdure.home.skills.open_fridge import OpenFridge
from perdure.home.skills.pick import Pick
from perdure.home.skills.place import GOAL_RADIUS, Place
from perdure.home.skills.regions import Aim, region
from perdure.home.skills.reset_arm import ResetArm, rest_error
from perdure.home.skills.skill import Element, Progress, Skill, rest_distance

SKILLS: dict[str, type[Skill]] = {
    each.name: each for each in (Pick, Place, OpenDrawer, CloseDrawer, OpenFridge, CloseFridge, Navigate, ResetArm)
}
"""All skills by name."""


def get_skill(name: str, **options: Any) -> Skill:
    """A skill by name; options are the fields of its class, such as `delta` of place."""
    if name not in SKILLS:
        raise HomeError(f"no skill is named {name!r}; there are {', '.join(SKILLS)}")
    return SKILLS[name](**options)


__all__ = [
    "GOAL_RADIUS",
    "SKILLS",
    "Aim",
    "Articulated",
    "CloseDrawer",
    "CloseFridge",
    "Element",
    "Navigate",
    "OpenDrawer",
    "OpenFridge",
    "Pick",
    "Place",
    "Progress",
    "ResetArm",
    "Skill",
    "get_skill",
    "holds_handle",
    "region",
    "rest_distance",
    "rest_error",
]
