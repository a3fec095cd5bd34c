"""Pick begins within 2 m of the object, its container open (M3, `pick_v1`) and the robot in front of it (OURS).

Where the plan opens the fridge first, half the starts are as the skills before it leave things (OURS): the door has
stopped at a right angle, and a robot that comes from the side where it opens stands before its edge. Few of M3's
starts are such (the door uniform up to wide open), and a policy that learned from those alone did not get past it in 10
of 100 task plans.
"""

from __future__ import annotations

import numpy as np

from perdure.home.benchmark.episodes import Episode
from perdure.home.sim.world import SkillGoal
from perdure.home.skills.skill_goals import front
from perdure.home.skills.starts.arm import draw_arm
from perdure.home.skills.starts.containers import FRIDGE_DOOR, carried, draw_open
from perdure.home.skills.starts.open_fridge import RECTANGLES
from perdure.home.skills.starts.stand import Rectangle, stand_in, stand_near
from perdure.home.skills.starts.start import Start

JUST_OPENED = (1.4, 1.7)
"""Where `open_fridge` leaves the door, in [rad]; uniform."""
ARRIVED: Rectangle = ((1.6, 1.9), 0.5)
"""Where `navigate` stops before the fridge, in the fridge's frame in [m]: where its region begins for who comes from
the room. Without a free cell there, where `open_fridge` begins."""


def draw(episode: Episode, target: int, rng: np.random.Generator) -> Start:
    """See `Draw`. What the robot faces is the object where the episode begins, as in M3."""
    apartment, point = episode.apartment(), episode.objects[target].position
    container, facing = episode.container(target), front(episode, target, "pick")
    if container == FRIDGE_DOOR and container not in episode.opened and rng.random() < 0.5:
        opened = {container: float(rng.uniform(*JUST_OPENED))}
        base = stand_in(apartment, apartment.piece_of(container).pose, (ARRIVED, *RECTANGLES), point, rng)
    else:
        opened = draw_open(apartment, container, rng)
        base = stand_near(apartment, point, rng, None if container is None else facing)
    return Start(
        base=base,
        arm=draw_arm(rng),
        skill_goal=SkillGoal(0, episode.goals[target].position, toward="pick", aim=point, front=facing),
        opened=opened,
        moved=carried(episode, target, opened),
    )
