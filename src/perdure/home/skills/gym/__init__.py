"""Gymnasium environments of the skills. Importing this package imports gymnasium and registers them.

Contents:
    perdure/HomePick-v0, HomePlace-v0, ...  names for `gymnasium.make` and `gymnasium.make_vec`
    HomeSkillVectorEnv, HomeSkillEnv        many lanes over one world; one lane
    SkillEnvOptions                         their options
    HeadDepth, VectorHeadDepth              wrappers that add the head camera's depth image
    register, env_id                        registration and names of the environments
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
    """Import the depth wrappers, which need OpenGL, when they are first used."""
    if name in ("HeadDepth", "VectorHeadDepth"):
        from perdure.home.skills.gym import depth as module

        return getattr(module, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
