"""Gymnasium environments of the skills; importing this module registers them, such as perdure/HomePick-v0.

`HeadDepth` and `VectorHeadDepth` add the head camera's depth image to their observations.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorEnv, VectorObservationWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from perdure.errors import PerdureError
from perdure.home.sim.head_camera import FAR, SIDE, HeadCamera
from perdure.home.skills.environment import SUITE, HomeSkillEnv, HomeSkillVectorEnv, SkillEnvOptions, register
from perdure.home.skills.registry import env_id

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

if TYPE_CHECKING:
    AnyVectorWrapper = VectorObservationWrapper[Any, Any, Any, Any]
else:
    AnyVectorWrapper = VectorObservationWrapper  # takes type parameters from Gymnasium 1.4 on

Observation = dict[str, NDArray[Any]]
"""`state`: the observation of the environment; `head_depth`: float32 from 0 to 1."""


class VectorHeadDepth(AnyVectorWrapper):
    """Observations {"state", "head_depth"} of a `HomeSkillVectorEnv`. Everything else stays bitwise equal.

    `state` is the original observation, shape (n, d). `head_depth` is float32 of shape (n, side, side), the upper left
    pixel first: planar depth in units of 10 m, 1 for everything farther, as in M3
    (`configs/rearrange/tasks/__base__.py`: 128 x 128 pixels, 90 degrees, 0 to 10 m, normalized). The camera is
    `perdure.home.sim.head_camera.HeadCamera`.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], side: int = SIDE) -> None:
        """Wrap a vector environment and open an OpenGL context.

        Args:
            env: A `HomeSkillVectorEnv`, wrapped or not.
            side: Width and height of the images in pixels.

        Raises:
            PerdureError: If the environment is another one, or this machine cannot render.
        """
        super().__init__(env)
        lanes = env.unwrapped
        if not isinstance(lanes, HomeSkillVectorEnv):
            raise PerdureError(f"env must be a home skill environment, not {env}")
        self._lanes = lanes
        self._camera = HeadCamera(side)
        self.single_observation_space = _with_depth(env.single_observation_space, side)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)

    def observations(self, observations: Any) -> Observation:
        """Return the observations with the current images."""
        images = [_image(self._camera, self._lanes, number) for number in range(self.num_envs)]
        return {"state": observations, "head_depth": np.stack(images)}

    def close(self, **kwargs: Any) -> None:
        """Close the camera and the environment."""
        self._camera.close()
        super().close(**kwargs)


class HeadDepth(gymnasium.ObservationWrapper[Any, Any, Any], RecordConstructorArgs):
    """`VectorHeadDepth` for one `HomeSkillEnv`: shapes (d,) and (side, side)."""

    def __init__(self, env: gymnasium.Env[Any, Any], side: int = SIDE) -> None:
        """Wrap an environment, see `VectorHeadDepth`."""
        RecordConstructorArgs.__init__(self, side=side)
        gymnasium.ObservationWrapper.__init__(self, env)
        if not isinstance(env.unwrapped, HomeSkillEnv):
            raise PerdureError(f"env must be a home skill environment, not {env}")
        self._lanes = env.unwrapped.lanes
        self._camera = HeadCamera(side)
        self.observation_space = _with_depth(env.observation_space, side)

    def observation(self, observation: Any) -> Observation:
        """Return the observation with the current image."""
        return {"state": observation, "head_depth": _image(self._camera, self._lanes, 0)}

    def close(self) -> None:
        """Close the camera and the environment."""
        self._camera.close()
        super().close()


def _image(camera: HeadCamera, lanes: HomeSkillVectorEnv, number: int) -> NDArray[np.float32]:
    return camera.take(lanes.world.simulator(number)) / np.float32(FAR)


def _with_depth(state: gymnasium.Space[Any], side: int) -> gymnasium.spaces.Dict:
    return gymnasium.spaces.Dict(
        {"state": state, "head_depth": gymnasium.spaces.Box(0.0, 1.0, (side, side), dtype=np.float32)}
    )


register()
