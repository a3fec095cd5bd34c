"""Gymnasium environments in which skills are learned. Importing this package imports gymnasium and registers them.

Contents:
    perdure/HomePick-v0, HomePlace-v0, ...  what `gymnasium.make` and `make_vec` know after the import
    HomeSkillVectorEnv, HomeSkillEnv        many lanes over one world; one lane
    SkillEnvOptions                           their options
    HeadDepth, VectorHeadDepth              wrappers that add the head camera's depth image
    register, env_id                        the names
"""

from typing import TYPE_CHECKING

from perdure.home.skills.gym.options import SkillEnvOptions
from perdure.home.skills.gym.register import SUITE, env_id, register
from perdure.home.skills.gym.single import HomeSkillEnv
from perdure.home.skills.gym.vector import HomeSkillVectorEnv

if TYPE_CHECKING:
    from perdure.home.skills.gym.depth import HeadDepth, VectorHeadDepth

__all__ = [
    "SUITE",
    "HeadDepth",
    "HomeSkillEnv",
    "HomeSkillVectorEnv",
    "SkillEnvOptions",
    "VectorHeadDepth",
    "env_id",
    "register",
]

register()


def __getattr__(name: str) -> object:
    """Loads what draws only when it is asked for."""
    if name in ("HeadDepth", "VectorHeadDepth"):
        from perdure.home.skills.gym import depth as module

        return getattr(module, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
