"""Navigate begins anywhere, the object in hand if it is to be placed next (M3, `nav_v1*`)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from perdure.home.benchmark.episodes import Episode
from perdure.home.sim.apartments import Apartment, Geodesic
from perdure.home.sim.world import SkillGoal
from perdure.home.skills import Aim, region
from perdure.home.skills.skill_goals import make_aim
from perdure.home.skills.starts.arm import draw_arm
from perdure.home.skills.starts.articulated import at_goal, container_of
from perdure.home.skills.starts.containers import is_drawer, link_number
from perdure.home.skills.starts.stand import stand_anywhere
from perdure.home.skills.starts.start import Start

DRAWER_OPEN, FRIDGE_OPEN = (0.4, 0.45, 0.5), (1.5, 1.8, 2.1, 2.35)
"""OURS: how far what was opened before is open, by the episode's number, so that ways can be kept; [m], [rad]."""


def draw(episode: Episode, target: int, rng: np.random.Generator) -> Start:
    """See `Draw`: one of the times the task's plan drives for this target, what was opened before being open."""
    plan = episode.home_task.skills
    times = [k for k, step in enumerate(plan) if step.skill == "navigate" and step.target == target]
    time = times[int(rng.integers(len(times)))]
    toward = plan[time].toward
    assert toward is not None
    apartment, opened = episode.apartment(), opened_before(episode, time)
    aim = make_aim(episode, toward, target, opened)
    acts_on_handle = toward.split("_")[0] in ("open", "close")
    link = link_number(apartment, aim.link) if acts_on_handle and aim.link is not None else -1
    route = _route(apartment, tuple(sorted(opened.items())), aim)
    return Start(
        base=stand_anywhere(apartment, opened, rng),
        arm=draw_arm(rng),
        skill_goal=SkillGoal(0, episode.goals[target].position, link, toward, aim.point, route),
        opened=opened,
        held=0 if toward == "place" else -1,
        moved=at_goal(episode, target) if toward.startswith("close") else {},
    )


def opened_before(episode: Episode, time: int) -> dict[str, float]:
    """What is open when a step of the plan begins, if all went well before."""
    opened = dict(episode.opened)
    for step in episode.home_task.skills[:time]:
        if step.skill in ("open_drawer", "open_fridge"):
            link = container_of(episode, step.target)
            positions = DRAWER_OPEN if is_drawer(episode.apartment(), link) else FRIDGE_OPEN
            opened[link] = positions[episode.index % len(positions)]
        elif step.skill in ("close_drawer", "close_fridge"):
            opened.pop(container_of(episode, step.target), None)
    return opened


@lru_cache(maxsize=1024)
def _route(apartment: Apartment, opened: tuple[tuple[str, float], ...], aim: Aim) -> Geodesic:
    """The way to where the next skill may begin; at most 0.3 MB each."""
    space, cells = region(apartment, dict(opened), aim)
    return space.distances(cells)
