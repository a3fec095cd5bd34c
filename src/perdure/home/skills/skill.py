"""The base class of skills: all that a skill declares, and the rules that all skills share.

Skills are pure functions over `PrivilegedState` and `SkillProgress`. Environments and the executor drive them. All
functions work row by row, so the result of a lane does not depend on its neighbors.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from perdure.home.benchmark.episodes import Episode
from perdure.home.sim.apartments import Pose
from perdure.home.sim.arrays import BoolArray, FloatArray, IntArray
from perdure.home.sim.objects import Placement
from perdure.home.sim.robot.data import BASE_RADIUS
from perdure.home.sim.world import ACTION_SIZE, ARM_STEP, BASE_SPEED, GRIP, PrivilegedState, SkillGoal
from perdure.home.skills import starts
from perdure.home.skills.observation import SECTOR_DEPTH, Element, ObservationTerm, rest_distance
from perdure.home.skills.progress import HANDLE_LIMIT, HOLD_LIMIT, SkillProgress, counted_force, invalid_grasp
from perdure.home.skills.recipe import Recipe
from perdure.home.skills.regions import Aim

__all__ = [
    "Aim",
    "BoolArray",
    "FloatArray",
    "IntArray",
    "Recipe",
    "Skill",
    "SkillProgress",
]  # all that a skill's file needs

SUCCESS_REWARD = 2.5
SLACK = 0.002
"""Cost of every step (M3; 0 when a drawer or door is opened or closed)."""
PENALTY = 1.0
"""Cost of a failure (M3; OURS for letting go of a handle early and for leaving the goal, which cost nothing there)."""
FORCE_COST, FORCE_CAP = 0.001, 0.2
"""Cost per newton of increase in contact force, and its cap per step (M3's numbers; see `progress.FORCE_MARGIN`)."""
RETRACTED = 0.05
"""Largest distance of a retracted gripper point from its rest position in [m] (M3)."""


@dataclass(frozen=True)
class Skill(ABC):
    """A skill. Class variables declare it; methods with a default fit skills that act on an object."""

    name: ClassVar[str]
    step_limit: ClassVar[int] = 200
    """Control steps (30 per second) after which the skill is stopped, as in M3's composite tasks."""
    observation: ClassVar[tuple[ObservationTerm, ...]]
    """The parts of an observation."""
    rewards: ClassVar[Mapping[str, str]] = {}
    """What each term of `reward_terms` pays, in words."""
    success_text: ClassVar[str]
    """When `success` is true, in words."""
    failures: ClassVar[Mapping[str, str]] = {
        "invalid grasp": f"a held object is over {HOLD_LIMIT:g} m, or a held handle over {HANDLE_LIMIT:g} m, from the "
        "gripper point",
        "excess force": "the increases of the contact force add up to more than the skill's limit",
    }
    """When each of `failure_conditions` is true, in words. Of several that are true the first one counts."""
    recipe: ClassVar[Recipe | None] = None
    """How the skill is trained; None for a scripted skill, which has no environment."""
    task_recipes: ClassVar[Mapping[str, Recipe]] = {}
    """Other recipes, by task."""

    active_columns: ClassVar[tuple[int, ...]] = tuple(range(GRIP + 1))
    """The columns of the robot's action that a policy sets; the others are 0."""
    grip_text: ClassVar[str] = "above 0: grasp the nearest object or handle, below 0: let go"
    """What the grip action does."""
    base_speed: ClassVar[float] = BASE_SPEED
    """Speed for a base action of 1 in [m/s] and [rad/s]."""
    arm_step: ClassVar[float] = ARM_STEP
    """Change of a joint's servo target for an arm action of 1 in [rad] per step."""
    scan_reach: ClassVar[float] = BASE_RADIUS + SECTOR_DEPTH
    """Range of the scan around the base in [m], 0 for no scan. Obstacles farther away must not change the observation:
    the executor scans once for all skills, with the largest range."""
    needs_neighbors: ClassVar[bool] = False
    """Whether the observation contains the objects and handles near the target."""
    slack: ClassVar[float] = SLACK
    """Cost of every step."""
    force_limit: ClassVar[float] = np.inf
    """Sum of the increases of the contact force in [N] that ends the skill."""
    object_at_start: ClassVar[Literal["start", "gripper", "goal"]] = "start"
    """Where the target object is when the skill begins."""
    moves_link: ClassVar[bool] = False
    """Whether the skill moves a drawer or door."""
    ends_with_empty_hand: ClassVar[bool] = False
    """Whether the executor opens the hand after a time-out (M3)."""

    @property
    def limit(self) -> int:
        """Return the control steps after which the skill is stopped."""
        return self.step_limit

    def observation_terms(self) -> tuple[ObservationTerm, ...]:
        """Return the parts of an observation."""
        return self.observation

    @property
    def elements(self) -> tuple[Element, ...]:
        """Return the documentation of every number of an observation, in order."""
        return tuple(element for term in self.observation_terms() for element in term.elements)

    @property
    def failure_labels(self) -> tuple[str, ...]:
        """Return the names of the numbers that `failure` returns; 0 is "none"."""
        return ("none", *self.failures)

    @abstractmethod
    def success(self, state: PrivilegedState, progress: SkillProgress) -> BoolArray:
        """Return whether the skill has succeeded. Shape (n,)."""

    def stop(self, state: PrivilegedState, progress: SkillProgress) -> BoolArray:
        """Return whether the executor goes on to the next skill: on success by default. Shape (n,)."""
        return self.success(state, progress)

    def reward_terms(
        self, before: PrivilegedState, after: PrivilegedState, was: SkillProgress, now: SkillProgress
    ) -> Mapping[str, FloatArray]:
        """Return the reward terms of a step, without success, slack, force and failure. Each of shape (n,).

        Args:
            before: The state before the step.
            after: The state after it.
            was: The progress before the step.
            now: The progress after it.
        """
        return {}

    def failure_conditions(self, state: PrivilegedState, progress: SkillProgress) -> Mapping[str, BoolArray]:
        """Return for each name of `failures` where it is true. Each of shape (n,)."""
        return {"invalid grasp": invalid_grasp(state), "excess force": progress.force_sum > self.force_limit}

    def unmet(self, state: PrivilegedState, progress: SkillProgress) -> Mapping[str, BoolArray]:
        """Return the unmet conditions of success in words, most basic first, where known. Each of shape (n,)."""
        return {}

    def mask(self, actions: FloatArray, state: PrivilegedState) -> FloatArray:
        """Return the actions without what the skill forbids. Shape (n, 11)."""
        return actions

    def expand_action(self, actions: FloatArray) -> FloatArray:
        """Return full actions from those of `active_columns`, 0 elsewhere. Shape (n, m) -> (n, 11)."""
        full = np.zeros((len(actions), ACTION_SIZE))
        full[:, list(self.active_columns)] = actions
        return full

    def placement(self, episode: Episode, target: int) -> Placement:
        """Return where the skill acts: at the start of the target object by default."""
        return episode.objects[target]

    def aim(self, episode: Episode, target: int, opened: Mapping[str, float]) -> Aim:
        """Return what navigation to this skill should face. Objects count as unmoved since the start (M3).

        `opened` are the positions of open drawers and doors by link name.
        """
        placement = self.placement(episode, target)
        return Aim(placement.position, episode.apartment().container(placement.receptacle))

    def skill_goal(
        self, episode: Episode, target: int, opened: Mapping[str, float], toward: str | None = None
    ) -> SkillGoal:
        """Return the goal of the skill in an episode; `toward` is the name of the next skill, for navigation.

        `opened` are the positions of open drawers and doors by link name.
        """
        aim, apartment = self.aim(episode, target, opened), episode.apartment()
        return SkillGoal(
            target,
            episode.goals[target].position,
            starts.link_number(apartment, aim.link) if self.moves_link and aim.link is not None else -1,
            self.name,
            aim.point,
            front=starts.front_of(apartment, self.placement(episode, target)),
        )

    def draw_start(self, episode: Episode, target: int, rng: np.random.Generator) -> starts.Start:
        """Draw a start state for training, without a check for contacts.

        By default the robot stands within 2 m of what it acts on, faces it, and its container is open (M3, `pick_v1`,
        `place_v1`).
        """
        apartment = episode.apartment()
        opened = starts.draw_open(apartment, apartment.container(self.placement(episode, target).receptacle), rng)
        return self.make_start(episode, target, opened, self.draw_base(episode, target, rng), rng)

    def draw_base(self, episode: Episode, target: int, rng: np.random.Generator) -> Pose:
        """Draw where the robot stands; in front of the container if there is one (OURS)."""
        apartment, placement = episode.apartment(), self.placement(episode, target)
        inside = apartment.container(placement.receptacle) is not None
        return starts.stand_near(
            apartment, placement.position, rng, starts.front_of(apartment, placement) if inside else None
        )

    def make_start(
        self, episode: Episode, target: int, opened: Mapping[str, float], base: Pose, rng: np.random.Generator
    ) -> starts.Start:
        """Return a start state with the arm near rest and the object where `object_at_start` says."""
        moved = {"start": starts.carried(episode, target, opened), "gripper": {}, "goal": {0: episode.goals[target]}}
        return starts.Start(
            base=base,
            arm=starts.draw_arm(rng),
            skill_goal=replace(self.skill_goal(episode, target, opened), target=0),
            opened=opened,
            held=0 if self.object_at_start == "gripper" else -1,
            moved=moved[self.object_at_start],
        )

    def observe(self, state: PrivilegedState, progress: SkillProgress) -> FloatArray:
        """Return observations. Shape (n, len(elements))."""
        columns = [column for term in self.observation_terms() for column in term.read(state, progress)]
        return np.concatenate([each[:, None] if each.ndim == 1 else each for each in columns], axis=1)

    def begin(self, state: PrivilegedState) -> SkillProgress:
        """Return the progress at the first step."""
        n, no = len(state), np.zeros(len(state), dtype=bool)
        zero = np.zeros(n, dtype=np.int64)
        return self.remember(SkillProgress(zero, no, no, zero, no, no, counted_force(state), np.zeros(n)), state)

    def advance(self, progress: SkillProgress, state: PrivilegedState) -> SkillProgress:
        """Return the progress one control step later."""
        force = counted_force(state)
        rise = np.maximum(force - progress.force, 0.0)
        later = replace(progress, elapsed=progress.elapsed + 1, force=force, force_sum=progress.force_sum + rise)
        return self.remember(later, state)

    def remember(self, progress: SkillProgress, state: PrivilegedState) -> SkillProgress:
        """Return the progress with the skill's own entries updated."""
        return replace(progress, away=progress.away | (rest_distance(state) > 0.3))

    def failure(self, state: PrivilegedState, progress: SkillProgress) -> IntArray:
        """Return which failure ends the skill as a number of `failure_labels`. Shape (n,)."""
        conditions, result = self.failure_conditions(state, progress), np.zeros(len(state), dtype=np.int64)
        for number, name in reversed(list(enumerate(self.failures, start=1))):
            result[conditions[name]] = number
        return result

    def reward(
        self, before: PrivilegedState, after: PrivilegedState, was: SkillProgress, now: SkillProgress
    ) -> tuple[FloatArray, Mapping[str, FloatArray]]:
        """Return the reward of a step and all its terms, shape (n,) each; arguments as of `reward_terms`."""
        terms = dict(self.reward_terms(before, after, was, now))
        rise = np.maximum(now.force - was.force, 0.0)
        terms["force"] = -np.minimum(FORCE_COST * rise, FORCE_CAP)
        terms["slack"] = np.full(len(now), -self.slack)
        terms["failure"] = np.where(self.failure(after, now) > 0, -PENALTY, 0.0)
        terms["success"] = np.where(self.success(after, now), SUCCESS_REWARD, 0.0)
        total = np.zeros(len(now))
        for value in terms.values():
            total = total + value
        return total, terms
