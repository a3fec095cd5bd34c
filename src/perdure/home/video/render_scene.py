"""A copy of a lane that has visual geometry, for pictures only.

Visual geometry in the simulated scene would change the last bits of the physics, and with them the trajectory. So
episodes run without it, and the copy is set to the same positions before each picture.
"""

from __future__ import annotations

from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from perdure.home.benchmark.episodes import Episode, episode_scene, start_pose
from perdure.home.sim.world import SceneOptions, World


class RenderScene:
    """A context manager that holds the copy."""

    def __init__(self, episode: Episode, eval_seed: int) -> None:
        """Build the copy at the start of an episode."""
        scene = episode_scene(episode, SceneOptions(visuals=True))
        self._world = World(1, threads=1)
        self._world.reset(0, scene, start_pose(scene.apartment, episode, eval_seed))
        self.lane = self._world.lane(0)

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close its world."""
        self._world.close()

    def put(self, qpos: NDArray[np.float64]) -> None:
        """Set all positions to those of another lane of the episode. Shape (nq,)."""
        self.lane.qpos[:] = qpos
        self.lane.forward()
