"""Place begins within 2 m of the goal with the object in the gripper, the goal's container open (M3, `place_v1`)."""

from __future__ import annotations

import numpy as np

from perdure.home.episodes import Episode
from perdure.home.execute.errands import front
from perdure.home.starts.arm import draw_arm
from perdure.home.starts.containers import draw_open, goal_container
from perdure.home.starts.stand import stand_near
from perdure.home.starts.start import Start
from perdure.home.world import Errand


def draw(episode: Episode, target: int, rng: np.random.Generator) -> Start:
    """See `Draw`."""
    apartment, goal = episode.apartment(), episode.goals[target].position
    container, facing = goal_container(episode, target), front(episode, target, "place")
    opened = draw_open(apartment, container, rng)
    return Start(
        base=stand_near(apartment, goal, rng, None if container is None else facing),
        arm=draw_arm(rng),
        errand=Errand(0, goal, toward="place", aim=goal, front=facing),
        opened=opened,
        held=0,
    )
