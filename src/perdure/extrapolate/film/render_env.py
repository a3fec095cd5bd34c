"""The Gymnasium equivalent of a task, for rendering: EnvPool cannot render.

Robots of one name move alike in EnvPool and Gymnasium, up to rounding (`tests/envs/test_gymnasium_parity.py`): the two
use different builds of MuJoCo. After some hundred steps with contacts the trajectories differ. The failure that a film
shows is therefore searched for in the Gymnasium environment.
"""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from perdure.envs import GymnasiumWorld, OpenEnv
from perdure.envs.suites import GYMNASIUM_PREFIX
from perdure.extrapolate.film.errors import FilmError

ROBOTS = ("Ant", "HalfCheetah", "Hopper", "Humanoid", "HumanoidStandup", "InvertedDoublePendulum", "InvertedPendulum",
          "Pusher", "Reacher", "Swimmer", "Walker2d")  # fmt: skip
"""EnvPool's tasks that Gymnasium has under the same name."""
VERSIONS = {"v2": "v4", "v3": "v4", "v4": "v4", "v5": "v5"}
"""EnvPool's version to Gymnasium's, whose v2 and v3 need mujoco-py; v4 has the same dynamics and rewards."""
CONTACT_FORCES = 84
ZERO_FORCES = {("Ant", "v3"), ("Ant", "v2"), ("Humanoid", "v2"), ("Humanoid", "v3"), ("Humanoid", "v4")}
"""Tasks whose last CONTACT_FORCES observation components are zeros in EnvPool, as they were with MuJoCo 2."""


class _ZeroForces(gymnasium.ObservationWrapper[Any, Any, Any]):
    """Replaces the contact forces by zeros, or appends zeros if there are none."""

    def __init__(self, env: Any, size: int) -> None:
        super().__init__(env)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float64)

    def observation(self, observation: Any) -> NDArray[np.float64]:
        size = self.observation_space.shape[0]  # type: ignore[index]
        rows = np.zeros(size)
        rows[: size - CONTACT_FORCES] = observation[: size - CONTACT_FORCES]
        return rows


@dataclass(frozen=True)
class RenderEnv:
    """A MuJoCo environment of Gymnasium."""

    env_id: str
    forces: int | None = None
    """Length of an observation whose contact forces are zeros; None: as the environment gives it."""

    def build(self) -> Any:
        """Return a new environment without a step limit."""
        mujoco = _mujoco()
        mujoco.set_mju_user_warning(lambda message: None)  # advice for the author of the robot file
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about outdated versions
            env = gymnasium.make(self.env_id, max_episode_steps=-1, disable_env_checker=True)
        if not hasattr(env.unwrapped, "mujoco_renderer"):
            raise FilmError(f"{self.env_id} is not a MuJoCo environment of Gymnasium; only those can be filmed")
        return env if self.forces is None else _ZeroForces(env, self.forces)

    def open(self) -> OpenEnv:
        """Return a source of worlds of this environment."""
        limit = gymnasium.spec(self.env_id).max_episode_steps
        return OpenEnv(
            lambda seeds: GymnasiumWorld(
                [self.build] * len(seeds), seeds, f"{GYMNASIUM_PREFIX}{self.env_id}", default_horizon=limit
            )
        )


def _mujoco() -> Any:
    """Return MuJoCo, whose import loads the driver that MUJOCO_GL names."""
    try:
        return import_module("mujoco")
    except Exception as error:  # every driver fails in its own way
        reason = " ".join(str(error).split())
        raise FilmError(f"MuJoCo cannot be loaded (MUJOCO_GL={os.environ.get('MUJOCO_GL', '')}): {reason}") from None


def find_render_env(task: str, observation_size: int) -> RenderEnv:
    """Return the environment that is rendered instead of a task.

    Args:
        task: Its name, such as "Hopper-v3" or "gymnasium:Hopper-v5".
        observation_size: Of its policies.

    Raises:
        FilmError: If there is none.
    """
    if find_spec("mujoco") is None:
        raise FilmError("films need MuJoCo: pip install 'perdure[film]'")
    if task.startswith(GYMNASIUM_PREFIX):
        return RenderEnv(task.removeprefix(GYMNASIUM_PREFIX))
    robot, _, version = task.partition("-")
    if robot not in ROBOTS or version not in VERSIONS:
        raise FilmError(
            f"{task} cannot be filmed; films exist for {', '.join(ROBOTS)}, and for MuJoCo environments of Gymnasium "
            "(gymnasium:ID); for the home benchmark, see perdure home video"
        )
    zeros = (robot, version) in ZERO_FORCES
    return RenderEnv(f"{robot}-{VERSIONS[version]}", observation_size if zeros else None)
