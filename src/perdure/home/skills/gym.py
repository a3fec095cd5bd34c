"""Gymnasium environments of the skills; importing this module registers them, such as perdure/HomePick-v0."""

from __future__ import annotations

from typing import TYPE_CHECKING

from perdure.home.skills.environment import (
    SUITE,
    HomeSkillEnv,
    HomeSkillVectorEnv,
    SkillEnvOptions,
    register,
)
from perdure.home.skills.registry import env_id

if TYPE_CHECKING:
    from perdure.home.skills.depth import HeadDepth, VectorHeadDepth

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
        from perdure.home.skills import depth as module

        return getattr(module, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
