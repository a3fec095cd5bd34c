"""What a step of a task's plan is about, in the world as it is when the step begins."""

from __future__ import annotations

import math
from collections.abc import Mapping

from perdure.home.benchmark.episodes import Episode
from perdure.home.benchmark.tasks import SkillName, SkillStep
from perdure.home.sim.world import Lane, SkillGoal
from perdure.home.skills import Aim, region


def make_skill_goal(episode: Episode, step: SkillStep, lane: Lane) -> SkillGoal:
    """The skill_goal of one step of the plan.

    Args:
        episode: The episode the lane runs; its targets are the first objects of the scene.
        step: The step of the plan.
        lane: The lane, in the state in which the step begins.
    """
    opened = positions(lane)
    toward: SkillName = step.toward or step.skill
    aim = make_aim(episode, toward, step.target, opened)
    link = (
        lane.scene.links.index(aim.link) if aim.link is not None and toward.split("_")[0] in ("open", "close") else -1
    )
    goal = episode.goals[step.target].position
    if step.skill != "navigate":
        return SkillGoal(step.target, goal, link, toward, aim.point, front=front(episode, step.target, step.skill))
    space, cells = region(lane.scene.apartment, opened, aim)
    return SkillGoal(step.target, goal, link, toward, aim.point, space.distances(cells))


def make_aim(episode: Episode, skill: SkillName, target: int, opened: Mapping[str, float]) -> Aim:
    """What a skill is about, as navigation sees it. Objects count as lying where the episode begins (M3).

    Args:
        episode: The episode.
        skill: The skill.
        target: The target it is about.
        opened: How far drawers and doors are open now, by link name.
    """
    apartment = episode.apartment()
    container = episode.container(target)
    if skill == "place":
        goal = episode.goals[target]
        receptacle = apartment.receptacle(goal.receptacle)
        fridge = apartment.piece(receptacle.piece).kind == "fridge"
        return Aim(skill, goal.position, "top_door" if fridge else receptacle.link)
    if skill == "pick":
        return Aim(skill, episode.objects[target].position, container)
    if container is None:
        return Aim(skill, episode.objects[target].position)
    x, y, z = (float(value) for value in apartment.handle_to_room(container, opened.get(container, 0.0)))
    return Aim(skill, (x, y, z), container)


def front(episode: Episode, target: int, skill: SkillName) -> tuple[float, float]:
    """Which way the furniture faces that a target's goal is on or in (place), or that the target comes from."""
    apartment = episode.apartment()
    where = episode.goals[target].receptacle if skill == "place" else episode.objects[target].receptacle
    yaw = apartment.piece(apartment.receptacle(where).piece).pose.yaw
    return math.cos(yaw), math.sin(yaw)


def positions(lane: Lane) -> dict[str, float]:
    """How far drawers and doors are open, to a centimeter or degree or so, those that are closed left out.

    Rounded, so that free spaces are found again in the cache.
    """
    q = lane.qpos[lane.scene.link_qpos]
    rounded = {link: round(float(value), 2) for link, value in zip(lane.scene.links, q, strict=True)}
    return {link: value for link, value in rounded.items() if abs(value) > 0.02}
