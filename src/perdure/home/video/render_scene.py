"""A double of a lane that has visuals, for pictures only.

What is only seen changes the last bits of the physics, and with them the course of an episode. So episodes run without
visuals, and the double is put where everything is.
"""

from __future__ import annotations

from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from perdure.home.benchmark.episodes import Episode, episode_scene, start_pose
from perdure.home.sim.world import SceneOptions, World


class RenderScene:
    """Use it in a `with`."""

    def __init__(self, episode: Episode, eval_seed: int) -> None:
        """At the start of an episode."""
        scene = episode_scene(episode, SceneOptions(visuals=True))
        self._world = World(1, threads=1)
        self._world.reset(0, scene, start_pose(scene.apartment, episode, eval_seed))
        self.lane = self._world.lane(0)

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Ends its world."""
        self._world.close()

    def put(self, qpos: NDArray[np.float64]) -> None:
        """Puts everything where it is in another lane of the episode, by that lane's `qpos`. Shape (nq,)."""
        self.lane.qpos[:] = qpos
        self.lane.forward()
