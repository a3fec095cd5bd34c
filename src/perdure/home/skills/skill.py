"""What a skill is: observation, rewards, success and failure, start states; what it remembers between control steps.

Skills are pure functions over `PrivilegedState` and `SkillProgress`. Environments and the executor drive them. All
functions work row by row, so the result of a lane does not depend on its neighbors.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal

import numpy as np

from perdure.home.sim.arrays import BoolArray, FloatArray, IntArray, Rows
from perdure.home.sim.objects import Placement
from perdure.home.sim.pieces import Pose
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.sensors import BEAMS, SCAN_RANGE, PrivilegedState, SkillGoal, norm, wrap
from perdure.home.sim.simulator import ARM_STEP, BASE_SPEED
from perdure.home.skills import starts
from perdure.home.skills.starts import Aim
from perdure.home.tasks.episodes import Episode

FORCE_MARGIN = 20.0
"""Contact forces up to this count as 0, in [N] (M3's number). Only increases in force are penalized (our choice). M3's
`RobotForce` penalizes a lasting contact in every step, because its reference force does not rise with the contact."""
HOLD_LIMIT = 0.09
HANDLE_LIMIT = 0.2
"""Largest distance in [m] of a held object from where the hand holds it, and of a held handle from the gripper point;
beyond it the grasp is invalid (M3)."""


@dataclass(frozen=True)
class SkillProgress(Rows):
    """What skills remember of n lanes. Arrays have shape (n,) where nothing else is said."""

    elapsed: IntArray
    """Control steps since the skill began."""
    grasped: BoolArray
    """Whether the right object or handle has been held (place: it is held at the start)."""
    released: BoolArray
    """Whether it has been released after that."""
    lasting: IntArray
    """Number of consecutive steps, up to now, in which the object rested in its goal region (place), or the robot
    stayed near its anchor (navigate)."""
    reached: BoolArray
    """Whether the drawer, door or object has been in its goal region."""
    away: BoolArray
    """Whether the gripper point has been more than 0.3 m from its rest position."""
    force: FloatArray
    """Counted contact force of the previous step in [N], see `counted_force`."""
    force_sum: FloatArray
    """Sum of its increases in [N]."""
    anchor: FloatArray
    """Base pose from which a robot counts as moved: x, y, heading (navigate). Shape (n, 3)."""


def counted_force(state: PrivilegedState) -> FloatArray:
    """Return the contact force in [N], 0 up to `FORCE_MARGIN`. Shape (n,)."""
    return np.where(state.contact_force > FORCE_MARGIN, state.contact_force, 0.0)


@dataclass(frozen=True)
class Recipe:
    """How a skill is trained (our choice; M3 trains from images)."""

    total_steps: int
    """Environment steps."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Settings of the algorithm that differ from those of all skills, `perdure.home.skills.train.SETTINGS`."""
    clutter: bool = False
    """Train with the objects that are no targets. They cost time, and only pick must tell them from its target."""

    @property
    def env_options(self) -> dict[str, object]:
        """Return environment options of training only; policies are scored with clutter from M3's start states."""
        if self.clutter:
            return {"clutter": True, "training": True}
        return {"training": True}


SECTORS = BEAMS // 2
SECTOR_DEPTH = 1.0
"""Range of the closeness block in [m], measured from the base's rim (our choice)."""
CONTACT_SCALE = 20.0
"""Scale of the contact force in its logarithm in [N] (our choice)."""


@dataclass(frozen=True)
class Element:
    """The documentation of one number of an observation."""

    name: str
    meaning: str
    unit: str
    low: float = -np.inf
    high: float = np.inf


@dataclass(frozen=True)
class ObservationBlock:
    """A block of consecutive numbers of an observation."""

    elements: tuple[Element, ...]
    """One for each number."""
    read: Callable[[PrivilegedState, SkillProgress], list[FloatArray]]
    """Returns the values of n lanes as arrays of shape (n,) or (n, k), in the order of `elements`."""


def flag(name: str, meaning: str) -> Element:
    """Return an element that is 1 when something holds, else 0."""
    return Element(name, f"1 when {meaning}, else 0", "1", 0.0, 1.0)


def vector(name: str, meaning: str, axes: str = "xyz", unit: str = "m", bound: float = np.inf) -> tuple[Element, ...]:
    """Return one element for each component of a vector along the base's axes."""
    return tuple(Element(f"{name}_{axis}", f"{meaning}, {axis}", unit, -bound, bound) for axis in axes)


def point(name: str, what: str, read: Callable[[PrivilegedState], FloatArray]) -> ObservationBlock:
    """Return the block of a point of the room: relative to the gripper point, then in the base frame.

    `name` is the prefix of the six elements, `what` the point in words; `read` returns the points in the room, (n, 3).
    """
    elements = (
        *vector(f"{name}_from_gripper", f"vector from the gripper point to {what}"),
        *vector(f"{name}_in_base", f"position of {what} in the base frame"),
    )
    return ObservationBlock(elements, lambda state, _: _point(state, read(state)))


def reaching(force_limit: float) -> ObservationBlock:
    """Return the block for reaching into furniture: contact forces, and the side on which the furniture is open.

    `force_limit` is the sum of force increases in [N] that ends the skill.
    """
    elements = (
        Element("contact", "log(1 + contact force / 20 N)", "1", 0.0),
        Element("force_sum", "sum of force increases divided by the limit at which the skill fails", "1", 0.0, 1.0),
        *vector("front", "direction in which the furniture faces", "xy", "1", 1.0),
    )
    return ObservationBlock(
        elements,
        lambda state, progress: [
            np.log1p(state.contact_force / CONTACT_SCALE),
            np.minimum(progress.force_sum / force_limit, 1.0),
            facing(state, state.front),
        ],
    )


def facing(state: PrivilegedState, directions: FloatArray) -> FloatArray:
    """Return horizontal unit vectors of the room along the base's x and y axes. Shape (n, 3) -> (n, 2)."""
    return unit(state.turned_to_base(directions)[:, :2])


def unit(axes: FloatArray) -> FloatArray:
    """Return components of unit vectors clipped to [-1, 1]; rounding may exceed 1 by one bit."""
    return np.clip(axes, -1.0, 1.0)


def rest_distance(state: PrivilegedState) -> FloatArray:
    """Return d_ee^r, the distance of the gripper point from its rest position in [m]. Shape (n,)."""
    return norm(state.gripper_in_base - ROBOT.rest_position)


def _point(state: PrivilegedState, points: FloatArray) -> list[FloatArray]:
    return [state.turned_to_base(points - state.gripper), state.in_base(points)]


def _proprioception(state: PrivilegedState, _: SkillProgress) -> list[FloatArray]:
    rotation = unit(state.gripper_rotation)
    return [
        _wrapped(state.arm),
        state.arm_target - state.arm,
        state.base_velocity[:, [0, 2]],
        ROBOT.rest_position - state.gripper_in_base,
        rest_distance(state),
        rotation[:, :, 0],
        rotation[:, :, 2],
    ]


def _wrapped(arm: FloatArray) -> FloatArray:
    """Return arm angles with those of unlimited joints in [-pi, pi)."""
    result = arm.copy()
    result[:, ROBOT.continuous] = wrap(result[:, ROBOT.continuous])
    return result


def _closeness(state: PrivilegedState, _: SkillProgress) -> list[FloatArray]:
    """Return the nearest of three beams for each sector: 45 degrees wide, 15 shared with each neighbor."""
    ranges = state.scan
    before = np.roll(ranges, 1, axis=1)
    after = np.roll(ranges, -1, axis=1)
    nearest = np.minimum(np.minimum(before, ranges), after)[:, ::2]
    return [np.clip(1.0 - (nearest - ROBOT.base_radius) / SECTOR_DEPTH, 0.0, 1.0)]


PROPRIOCEPTION = ObservationBlock(
    (
        *(Element(name, f"angle of {name}", "rad", -np.pi, np.pi) for name in ROBOT.arm_names),
        *(Element(f"{name}_lag", f"servo target minus angle of {name}", "rad") for name in ROBOT.arm_names),
        Element("base_forward", "forward speed of the base", "m/s"),
        Element("base_turn", "turning speed of the base", "rad/s"),
        *vector("to_rest", "vector from the gripper point to its rest position, base frame"),
        Element("rest_distance", "d_ee^r: length of that vector", "m", 0.0),
        *vector("gripper_forward", "x axis of the gripper in the base frame", unit="1", bound=1.0),
        *vector("gripper_up", "z axis of the gripper in the base frame", unit="1", bound=1.0),
    ),
    _proprioception,
)
"""Arm, gripper and base as the robot's own encoders measure them: 26 numbers."""
CLOSENESS = ObservationBlock(
    tuple(
        Element(
            f"close_{k:02d}",
            f"closeness of obstacles in sector {k} of {SECTORS}, counter-clockwise from straight ahead: 1 at the "
            "base's rim, 0 from 1 m on",
            "1",
            0.0,
            1.0,
        )
        for k in range(SECTORS)
    ),
    _closeness,
)
SCAN = ObservationBlock(
    tuple(
        Element(
            f"scan_{k:02d}",
            f"range of beam {k} of {BEAMS}, counter-clockwise from straight ahead",
            "m",
            0.0,
            SCAN_RANGE,
        )
        for k in range(BEAMS)
    ),
    lambda state, _: [state.scan],
)
HOLDING = ObservationBlock((flag("holding", "something is held"),), lambda state, _: [(state.held >= 0).astype(float)])


SUCCESS_REWARD = 2.5
SLACK = 0.002
"""Cost of every step (M3; 0 when a drawer or door is opened or closed)."""
PENALTY = 1.0
"""Cost of a failure (M3; our choice for letting go of a handle early and for leaving the goal, which cost nothing
there)."""
FORCE_COST = 0.001
FORCE_CAP = 0.2
"""Cost per newton of increase in contact force, and its cap per step (M3's numbers; see `FORCE_MARGIN`)."""
RETRACTED = 0.05
"""Largest distance of a retracted gripper point from its rest position in [m] (M3)."""


@dataclass(frozen=True)
class Skill(ABC):
    """A skill. Class variables declare it; methods with a default fit skills that act on an object."""

    name: ClassVar[str]
    step_limit: ClassVar[int] = 200
    """Control steps (30 per second) after which the skill is stopped, as in M3's composite tasks."""
    observation: ClassVar[tuple[ObservationBlock, ...]]
    """The parts of an observation."""
    rewards: ClassVar[Mapping[str, str]] = {}
    """What each term of `reward_terms` pays, in words."""
    success_text: ClassVar[str]
    """When `success` is true, in words."""
    failures: ClassVar[Mapping[str, str]] = {
        "invalid grasp": f"a held object is over {HOLD_LIMIT:g} m from where the hand holds it, or a held handle over "
        f"{HANDLE_LIMIT:g} m from the gripper point",
        "excess force": "the increases of the contact force add up to more than the skill's limit",
    }
    """When each of `failure_conditions` is true, in words. Of several that are true the first one counts."""
    recipe: ClassVar[Recipe | None] = None
    """How the skill is trained; None for a scripted skill, which has no environment."""
    task_recipes: ClassVar[Mapping[str, Recipe]] = {}
    """Other recipes, by task."""

    active_columns: ClassVar[tuple[int, ...]] = tuple(range(ROBOT.action.grip + 1))
    """The columns of the robot's action that a policy sets; the others are 0."""
    grip_text: ClassVar[str] = "above 0: grasp the nearest object or handle, below 0: let go"
    """What the grip action does."""
    base_speed: ClassVar[float] = BASE_SPEED
    """Speed for a base action of 1 in [m/s] and [rad/s], where the base is so fast."""
    arm_step: ClassVar[float] = ARM_STEP
    """Change of a joint's servo target for an arm action of 1 in [rad] per step."""
    scan_reach: ClassVar[float] = ROBOT.base_radius + SECTOR_DEPTH
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

    def recipe_on(self, task: str) -> Recipe:
        """Return how a skill that is not scripted is trained on a task."""
        assert self.recipe is not None
        return self.task_recipes.get(task, self.recipe)

    @property
    def limit(self) -> int:
        """Return the control steps after which the skill is stopped."""
        return self.step_limit

    def observation_blocks(self) -> tuple[ObservationBlock, ...]:
        """Return the parts of an observation."""
        return self.observation

    @property
    def elements(self) -> tuple[Element, ...]:
        """Return the documentation of every number of an observation, in order."""
        return tuple(element for block in self.observation_blocks() for element in block.elements)

    @property
    def action_size(self) -> int:
        """Return how many numbers a policy's action has."""
        return len(self.active_columns)

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
        far = state.hold_error > np.where(state.held >= 0, HOLD_LIMIT, HANDLE_LIMIT)
        return {"invalid grasp": far & ~state.empty_hand, "excess force": progress.force_sum > self.force_limit}

    def unmet(self, state: PrivilegedState, progress: SkillProgress) -> Mapping[str, BoolArray]:
        """Return the unmet conditions of success in words, most basic first, where known. Each of shape (n,)."""
        return {}

    def mask(self, actions: FloatArray, state: PrivilegedState) -> FloatArray:
        """Return the actions without what the skill forbids. Shape (n, action size)."""
        return actions

    def expand_action(self, actions: FloatArray, state: PrivilegedState) -> FloatArray:
        """Return the robot's actions from a policy's: its `active_columns`, 0 elsewhere.

        Shape (n, m) -> (n, action size).
        """
        full = np.zeros((len(actions), ROBOT.action_size))
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
        """Return the goal of the skill in an episode; `opened` as in `aim`, `toward`: the next skill of navigation."""
        aim = self.aim(episode, target, opened)
        apartment = episode.apartment()
        link = -1
        if self.moves_link and aim.link is not None:
            link = starts.link_number(apartment, aim.link)
        return SkillGoal(
            target,
            episode.goals[target].position,
            link,
            self.name,
            aim.point,
            front=starts.front_of(apartment, self.placement(episode, target)),
        )

    def draw_start(self, episode: Episode, target: int, rng: np.random.Generator) -> starts.Start:
        """Draw a start state for training, without a check for contacts.

        By default the robot stands within 2 m of what it acts on, in front of its container, faces it, and the
        container is open (M3, `pick_v1`, `place_v1`).
        """
        apartment = episode.apartment()
        placement = self.placement(episode, target)
        container = apartment.container(placement.receptacle)
        opened = starts.draw_open(container, rng)
        front = None
        if container is not None:
            front = starts.front_of(apartment, placement)  # our choice
        base = starts.stand_near(apartment, placement.position, rng, front)
        return self.make_start(episode, target, opened, base, rng)

    def make_start(
        self, episode: Episode, target: int, opened: Mapping[str, float], base: Pose, rng: np.random.Generator
    ) -> starts.Start:
        """Return a start state with the arm near rest and the object where `object_at_start` says."""
        held = -1
        moved: Mapping[int, Placement] = {}
        arm = starts.draw_arm(rng)
        if self.object_at_start == "gripper":
            held = 0
            moved = {0: starts.draw_held(episode.objects[target], base, arm, rng)}
        elif self.object_at_start == "goal":
            moved = {0: episode.goals[target]}
        else:
            moved = starts.carried(episode, target, opened)
        return starts.Start(
            base=base,
            arm=arm,
            skill_goal=replace(self.skill_goal(episode, target, opened), target=0),
            opened=opened,
            held=held,
            moved=moved,
        )

    def recorded_start(self, episode: Episode, row: starts.PlanStart) -> starts.Start:
        """Return a recorded start state in its episode."""
        # The goal is made from where the planner took the target to be.
        _, target, toward = row.step
        receptacle, position = row.seen
        seen = replace(episode.objects[target], receptacle=receptacle, position=position)
        believed = replace(episode, objects=(*episode.objects[:target], seen, *episode.objects[target + 1 :]))
        goal = starts.keep_apart(self.skill_goal(believed, target, row.opened, toward), row.stood)

        # Before it is placed the target is in the hand.
        position, quaternion = row.pose
        held = -1
        moved = {0: replace(episode.objects[target], position=position, quaternion=quaternion)}
        if "place" in row.step:
            held = 0
        return starts.Start(
            Pose(*row.base), np.array(row.arm), replace(goal, target=0), row.opened, held=held, moved=moved
        )

    def observe(self, state: PrivilegedState, progress: SkillProgress) -> FloatArray:
        """Return observations. Shape (n, len(elements))."""
        columns = []
        for block in self.observation_blocks():
            for values in block.read(state, progress):
                if values.ndim == 1:
                    columns.append(values[:, None])
                else:
                    columns.append(values)
        return np.concatenate(columns, axis=1)

    def begin(self, state: PrivilegedState) -> SkillProgress:
        """Return the progress at the first step."""
        no = np.zeros(len(state), dtype=bool)
        zero = np.zeros(len(state), dtype=np.int64)
        progress = SkillProgress(
            elapsed=zero,
            grasped=no,
            released=no,
            lasting=zero,
            reached=no,
            away=no,
            force=counted_force(state),
            force_sum=np.zeros(len(state)),
            anchor=state.base,
        )
        return self.remember(progress, state)

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
        conditions = self.failure_conditions(state, progress)
        result = np.zeros(len(state), dtype=np.int64)
        for number, name in reversed(list(enumerate(self.failures, start=1))):
            result[conditions[name]] = number
        return result

    def reward(
        self, before: PrivilegedState, after: PrivilegedState, was: SkillProgress, now: SkillProgress
    ) -> tuple[FloatArray, Mapping[str, FloatArray]]:
        """Return the reward of a step and all its terms, shape (n,) each; arguments as of `reward_terms`."""
        terms = dict(self.reward_terms(before, after, was, now))
        terms["force"] = -np.minimum(FORCE_COST * np.maximum(now.force - was.force, 0.0), FORCE_CAP)
        terms["slack"] = np.full(len(now), -self.slack)
        terms["failure"] = np.where(self.failure(after, now) > 0, -PENALTY, 0.0)
        terms["success"] = np.where(self.success(after, now), SUCCESS_REWARD, 0.0)
        return sum(terms.values(), np.zeros(len(now))), terms
