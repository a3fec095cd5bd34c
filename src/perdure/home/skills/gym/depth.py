"""The head camera's depth image as a part of the observations, drawn only for those who wrap."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from perdure.home.errors import HomeError
from perdure.home.sim.camera.depth import FAR, SIDE, HeadCamera
from perdure.home.skills.gym.single import HomeSkillEnv
from perdure.home.skills.gym.vector import HomeSkillVectorEnv
from perdure.horizon.wrappers.any_vector_wrapper import AnyVectorWrapper

Observation = dict[str, NDArray[Any]]
"""`state`: what the environment observes; `head_depth`: float32 from 0 to 1."""


class VectorHeadDepth(AnyVectorWrapper):
    """Observations {"state", "head_depth"} of a `HomeSkillVectorEnv`. All else is as without it, to the last bit.

    `state` is the vector that was there before, shape (n, d). `head_depth` is planar depth in units of 10 m, 1 for
    everything farther, as in M3 (`configs/rearrange/tasks/__base__.py`: 128 x 128 pixels, 90 degrees, 0 to 10 m,
    normalized); times 10 it is meters. float32, shape (n, side, side), the upper left pixel first. Where the camera is
    and what it sees: `perdure.home.sim.camera.depth.HeadCamera`.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], side: int = SIDE) -> None:
        """Wraps a vector environment and opens an OpenGL context.

        Args:
            env: A `HomeSkillVectorEnv`, wrapped or not, which does not reset lanes in the step in which they end.
            side: Width and height of the images in pixels.

        Raises:
            HomeError: If the environment is another one, or no picture can be drawn on this machine.
        """
        super().__init__(env)
        lanes = env.unwrapped
        if not isinstance(lanes, HomeSkillVectorEnv):
            raise HomeError(f"a head depth image is there for home skills only, not for {env}")
        if lanes.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP:
            raise HomeError("with SAME_STEP an episode's last depth image is gone before it is drawn; use NEXT_STEP")
        self._lanes, self._camera = lanes, HeadCamera(side)
        self.single_observation_space = _with_depth(env.single_observation_space, side)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """See `HomeSkillVectorEnv.reset`."""
        observations, info = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]
        return self._observe(observations), info

    def step(self, actions: Any) -> tuple[Observation, Any, Any, Any, dict[str, Any]]:
        """See `HomeSkillVectorEnv.step`."""
        observations, *outcome = self.env.step(actions)
        return self._observe(observations), *outcome

    def close(self, **kwargs: Any) -> None:
        """Ends the camera and the environment."""
        self._camera.close()
        super().close(**kwargs)

    def _observe(self, observations: Any) -> Observation:
        images = [_image(self._camera, self._lanes, number) for number in range(self.num_envs)]
        return {"state": observations, "head_depth": np.stack(images)}


class HeadDepth(gymnasium.ObservationWrapper[Any, Any, Any], RecordConstructorArgs):
    """`VectorHeadDepth` for one `HomeSkillEnv`: shapes (d,) and (side, side)."""

    def __init__(self, env: gymnasium.Env[Any, Any], side: int = SIDE) -> None:
        """Wraps an environment, see `VectorHeadDepth`."""
        RecordConstructorArgs.__init__(self, side=side)
        gymnasium.ObservationWrapper.__init__(self, env)
        if not isinstance(env.unwrapped, HomeSkillEnv):
            raise HomeError(f"a head depth image is there for home skills only, not for {env}")
        self._lanes, self._camera = env.unwrapped.lanes, HeadCamera(side)
        self.observation_space = _with_depth(env.observation_space, side)

    def observation(self, observation: Any) -> Observation:
        """The observation with the image of now."""
        return {"state": observation, "head_depth": _image(self._camera, self._lanes, 0)}

    def close(self) -> None:
        """Ends the camera and the environment."""
        self._camera.close()
        super().close()


def _image(camera: HeadCamera, lanes: HomeSkillVectorEnv, number: int) -> NDArray[np.float32]:
    return camera.take(lanes.world.lane(number)) / np.float32(FAR)


def _with_depth(state: gymnasium.Space[Any], side: int) -> gymnasium.spaces.Dict:
    return gymnasium.spaces.Dict(
        {"state": state, "head_depth": gymnasium.spaces.Box(0.0, 1.0, (side, side), dtype=np.float32)}
    )
