"""Pick begins within 2 m of the object, its container open (M3, `pick_v1`)."""

from __future__ import annotations

import numpy as np

from perdure.home.episodes import Episode
from perdure.home.execute.errands import front, make_aim
from perdure.home.starts.arm import draw_arm
from perdure.home.starts.containers import carried, draw_open
from perdure.home.starts.stand import stand_near
from perdure.home.starts.start import Start
from perdure.home.starts.ways import way_for
from perdure.home.world import Errand


def draw(episode: Episode, target: int, rng: np.random.Generator) -> Start:
    """See `Draw`. What the robot faces is the object where the episode begins, as in M3."""
    apartment, point = episode.apartment(), episode.objects[target].position
    container = episode.container(target)
    opened = draw_open(apartment, container, rng)
    route = way_for(apartment, opened, make_aim(episode, "pick", target, opened))
    errand = Errand(0, episode.goals[target].position, -1, "pick", point, route, front(episode, target, "pick"))
    return Start(
        base=stand_near(apartment, point, rng),
        arm=draw_arm(rng),
        errand=errand,
        opened=opened,
        moved=carried(episode, target, opened),
    )
