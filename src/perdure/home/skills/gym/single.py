"""The environment of one skill with one lane."""

from __future__ import annotations

import warnings
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode

from perdure.home.errors import HomeError
from perdure.home.sim.arrays import FloatArray
from perdure.home.skills.gym.checks import checked_mode
from perdure.home.skills.gym.vector import HomeSkillVectorEnv


class HomeSkillEnv(gymnasium.Env[FloatArray, FloatArray]):
    """One lane of a `HomeSkillVectorEnv`: the same seed and actions give the same bits."""

    def __init__(
        self, *, threads: int = 1, autoreset_mode: AutoresetMode | str = AutoresetMode.DISABLED, **options: Any
    ) -> None:
        """Create the environment.

        Args:
            threads: As for the vector; one lane never uses more than one.
            autoreset_mode: DISABLED: the caller resets.
            options: Fields of `SkillEnvOptions`, and other settings of the vector.

        Raises:
            HomeError: If an option does not exist or fit, or for another autoreset mode.
        """
        if (mode := checked_mode(autoreset_mode)) is not AutoresetMode.DISABLED:
            raise HomeError(
                f"autoreset_mode of a single environment must be {AutoresetMode.DISABLED.value!r}, not {mode.value!r}; "
                "gymnasium.make_vec has the other modes"
            )
        self.lanes = HomeSkillVectorEnv(1, threads=threads, **options)
        self._unfinished = 0
        """Steps of an episode that is not over, 0 between episodes."""
        self._cut_before = 0
        """Steps of the episode that was cut off last."""
        self._warned = False
        self.observation_space = self.lanes.single_observation_space
        self.action_space = self.lanes.single_action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[FloatArray, dict[str, Any]]:
        """See `gymnasium.Env.reset`."""
        super().reset(seed=seed)
        self._warn_if_cut_off()
        self._unfinished = 0
        observations, _ = self.lanes.reset(seed=seed)
        return observations[0], {}

    def step(self, action: FloatArray) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:
        """See `gymnasium.Env.step`."""
        batch = np.asarray(action, dtype=np.float64)[None]
        observations, rewards, terminated, truncated, info = self.lanes.step(batch)
        self._unfinished = 0 if terminated[0] or truncated[0] else int(info["elapsed"][0])
        return observations[0], float(rewards[0]), bool(terminated[0]), bool(truncated[0]), _first(info)

    def close(self) -> None:
        """Release the lane's resources."""
        self.lanes.close()

    def _warn_if_cut_off(self) -> None:
        """Warn once of episodes too short for `delta`: the constructor does not see the limit of `make`.

        Two of the same length in a row, as one alone may have been cut off by a reset on purpose.
        """
        steps, delta, before = self._unfinished, self.lanes.options.delta, self._cut_before
        self._cut_before = steps
        if 0 < steps < delta and steps == before and not self._warned:
            self._warned = True
            warnings.warn(
                f"two episodes were cut off from outside after {steps} steps; with delta={delta} such an episode "
                f"cannot succeed: also give max_episode_steps={self.lanes.skill.limit}",
                stacklevel=3,
            )


def _first(info: dict[str, Any]) -> dict[str, Any]:
    """Return the entries of the only lane."""
    return {
        name: _first(value) if isinstance(value, dict) else value[0].item()
        for name, value in info.items()
        if not name.startswith("_")
    }
