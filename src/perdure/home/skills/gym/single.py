"""The environment of one skill with one lane."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from perdure.home.sim.arrays import FloatArray
from perdure.home.skills.gym.vector import HomeSkillVectorEnv


class HomeSkillEnv(gymnasium.Env[FloatArray, FloatArray]):
    """One lane of a `HomeSkillVectorEnv`: the same seed and actions give the same bits."""

    def __init__(self, **options: Any) -> None:
        """Create the environment from the fields of `SkillEnvOptions`."""
        self.lanes = HomeSkillVectorEnv(1, threads=1, **options)
        self.observation_space = self.lanes.single_observation_space
        self.action_space = self.lanes.single_action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[FloatArray, dict[str, Any]]:
        """See `gymnasium.Env.reset`."""
        super().reset(seed=seed)
        observations, _ = self.lanes.reset(seed=seed)
        return observations[0], {}

    def step(self, action: FloatArray) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:
        """See `gymnasium.Env.step`."""
        batch = np.asarray(action, dtype=np.float64)[None]
        observations, rewards, terminated, truncated, info = self.lanes.step(batch)
        return observations[0], float(rewards[0]), bool(terminated[0]), bool(truncated[0]), _first(info)

    def close(self) -> None:
        """Release the lane's resources."""
        self.lanes.close()


def _first(info: dict[str, Any]) -> dict[str, Any]:
    """Return the entries of the only lane."""
    return {
        name: _first(value) if isinstance(value, dict) else value[0].item()
        for name, value in info.items()
        if not name.startswith("_")
    }
