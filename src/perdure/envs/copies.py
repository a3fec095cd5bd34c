"""EnvPool's Ant and Humanoid on Gymnasium's MuJoCo; importing this module registers `perdure/Ant-v3` and their like.

EnvPool does not compute contact forces for these versions: the entries of the observation stay 0, and so does their
cost. Gymnasium's other v4 environments need no copy: they make EnvPool's steps as they are.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.mujoco.ant_v4 import AntEnv
from gymnasium.envs.mujoco.humanoid_v4 import HumanoidEnv

BODIES = 14
"""Bodies of both robots, the world included."""


class Ant(AntEnv):
    """Gymnasium's Ant-v4 without contact forces in the observation and in the reward."""

    contact_forces = np.zeros((BODIES, 6))


class Humanoid(HumanoidEnv):
    """Gymnasium's Humanoid-v4 without contact forces in the observation."""

    def _get_obs(self) -> Any:
        observation = super()._get_obs()  # type: ignore[no-untyped-call]
        observation[-6 * BODIES :] = 0.0
        return observation


gymnasium.register("perdure/Ant-v3", Ant, max_episode_steps=1000, kwargs={"use_contact_forces": True})
gymnasium.register("perdure/Humanoid-v3", Humanoid, max_episode_steps=1000)
