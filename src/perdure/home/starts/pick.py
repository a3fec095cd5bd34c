"""Pick begins within 2 m of the object, its container open (M3, `pick_v1`) and the robot in front of it (OURS)."""

from __future__ import annotations

import numpy as np

from perdure.home.episodes import Episode
from perdure.home.execute.errands import front
from perdure.home.starts.arm import draw_arm
from perdure.home.starts.containers import carried, draw_open
from perdure.home.starts.stand import stand_near
from perdure.home.starts.start import Start
from perdure.home.world import Errand


def draw(episode: Episode, target: int, rng: np.random.Generator) -> Start:
    """See `Draw`. What the robot faces is the object where the episode begins, as in M3."""
    apartment, point = episode.apartment(), episode.objects[target].position
    container, facing = episode.container(target), front(episode, target, "pick")
    opened = draw_open(apartment, container, rng)
    return Start(
        base=stand_near(apartment, point, rng, None if container is None else facing),
        arm=draw_arm(rng),
        errand=Errand(0, episode.goals[target].position, toward="pick", aim=point, front=facing),
        opened=opened,
        moved=carried(episode, target, opened),
    )
