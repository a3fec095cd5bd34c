"""Pick: grasp the target and bring the gripper back to its rest position."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from perdure.home.sim.arrays import BoolArray, FloatArray
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.sensors import NEIGHBORHOOD, NEIGHBORS, PrivilegedState, norm, wrap
from perdure.home.skills import skill as obs
from perdure.home.skills.skill import PROPRIOCEPTION, RETRACTED, Recipe, Skill, SkillProgress

DISTANCE_REWARD = 4.0
GRASP_REWARD = 1.0
FORCE_LIMIT = 5000.0
LEAD = 0.3
"""Clip of the `lead` element in [m]."""


def _neighbors(state: PrivilegedState, _: SkillProgress) -> list[FloatArray]:
    turned = [state.turned_to_base(state.neighbors[:, k]) for k in range(NEIGHBORS)]
    away = np.stack([norm(each) for each in turned], axis=1)
    near = np.where(away > 0.0, np.clip(1.0 - away / NEIGHBORHOOD, 0.0, 1.0), 0.0)
    lead = np.clip(state.neighbor_distance - norm(state.object - state.gripper), -LEAD, LEAD)
    return [*turned, near, lead, np.minimum(state.handle_distance, NEIGHBORHOOD)]


CONFUSABLE = obs.ObservationBlock(
    (
        *(
            element
            for k in range(NEIGHBORS)
            for element in obs.vector(f"neighbor_{k}", f"vector from the object to its neighbor {k}, 0 without one")
        ),
        *(
            obs.Element(
                f"neighbor_{k}_near", f"nearness of neighbor {k}: 1 at the object, 0 from 0.5 m on", "1", 0.0, 1.0
            )
            for k in range(NEIGHBORS)
        ),
        obs.Element(
            "lead",
            "distance from the gripper point to the nearest other object minus that to the target",
            "m",
            -LEAD,
            LEAD,
        ),
        obs.Element("handle_distance", "distance of the nearest handle from the gripper point", "m", 0.0, NEIGHBORHOOD),
    ),
    _neighbors,
)
"""What could be grasped instead of the target."""


@dataclass(frozen=True)
class Pick(Skill):
    """M3's reward. The observation of neighbors and contact is our choice."""

    name = "pick"
    observation = (
        obs.PROPRIOCEPTION,
        obs.CLOSENESS,
        obs.reaching(FORCE_LIMIT),
        obs.point("object", "the object", lambda state: state.object),
        CONFUSABLE,
        obs.HOLDING,
    )
    rewards: ClassVar = {
        "approach": f"{DISTANCE_REWARD:g} per meter nearer to the object while the hand is empty",
        "grasp": f"+{GRASP_REWARD:g} when the object is held for the first time",
        "retract": f"{DISTANCE_REWARD:g} per meter nearer to rest while it is held",
    }
    success_text = f"the target is held and the gripper is within {RETRACTED:g} m of rest"
    failures: ClassVar = {
        "wrong object": "the hand holds something other than the target",
        "dropped": "the target was held and has left the hand",
        **Skill.failures,
    }
    recipe = Recipe(4_000_000, {"log_std_init": 0.0, "log_std_end": -1.5, "log_std_fall": (0.1, 0.9)}, clutter=True)
    grip_text = "above 0: grasp the nearest object, if that is the target; pick never lets go"
    force_limit = FORCE_LIMIT
    needs_neighbors = True

    def reward_terms(
        self, before: PrivilegedState, after: PrivilegedState, was: SkillProgress, now: SkillProgress
    ) -> Mapping[str, FloatArray]:
        """See `Skill.reward_terms`."""
        approach = norm(before.object - before.gripper) - norm(after.object - after.gripper)
        retract = obs.rest_distance(before) - obs.rest_distance(after)
        # From the grasp on the object comes to the hand by itself, which is no approach.
        return {
            "approach": DISTANCE_REWARD * np.where(before.empty_hand & after.empty_hand, approach, 0.0),
            "retract": DISTANCE_REWARD * np.where(before.holds_target & after.holds_target, retract, 0.0),
            "grasp": np.where(now.grasped & ~was.grasped, GRASP_REWARD, 0.0),
        }

    def success(self, state: PrivilegedState, progress: SkillProgress) -> BoolArray:
        """See `success_text`."""
        return np.asarray(state.holds_target & (obs.rest_distance(state) <= RETRACTED))

    def failure_conditions(self, state: PrivilegedState, progress: SkillProgress) -> Mapping[str, BoolArray]:
        """See `failures`."""
        return {
            "wrong object": (state.held >= 0) & ~state.holds_target | (state.held_link >= 0),
            "dropped": progress.grasped & ~state.holds_target,
            **super().failure_conditions(state, progress),
        }

    def stop(self, state: PrivilegedState, progress: SkillProgress) -> BoolArray:
        """Stop when an object (M3: anything) is held and the gripper is back at rest."""
        return np.asarray((state.held >= 0) & (obs.rest_distance(state) < RETRACTED))

    def mask(self, actions: FloatArray, state: PrivilegedState) -> FloatArray:
        """Never let go (M3), and do not grasp anything but the target (our choice)."""
        masked = actions.copy()
        grip = np.maximum(actions[:, ROBOT.action.grip], 0.0)
        masked[:, ROBOT.action.grip] = np.where(state.grasp_is_right, grip, 0.0)
        return masked

    def remember(self, progress: SkillProgress, state: PrivilegedState) -> SkillProgress:
        """See `Skill.remember`."""
        return super().remember(replace(progress, grasped=progress.grasped | state.holds_target), state)


DONE = 0.05
"""Largest joint error of a reset arm in [rad] (habitat-lab)."""
FASTEST = 0.1
"""Largest change of a joint's servo target in a step in [rad] (M3)."""


@dataclass(frozen=True)
class ResetArm(Skill):
    """A scripted skill: it has no reward and no recipe."""

    name = "reset_arm"
    step_limit = 50
    observation = (PROPRIOCEPTION,)
    success_text = f"all joints are within {DONE:g} rad of rest"
    arm_step = FASTEST
    scan_reach = 0.0

    def success(self, state: PrivilegedState, progress: SkillProgress) -> BoolArray:
        """See `success_text`."""
        return np.asarray(np.abs(rest_error(state.arm)).max(axis=1) < DONE)

    def act(self, state: PrivilegedState) -> FloatArray:
        """Return actions that move every joint straight to rest, at most 0.1 rad in a step. Shape (n, action size)."""
        actions = np.zeros((len(state), ROBOT.action_size))
        actions[:, ROBOT.action.arm] = np.clip(rest_error(state.arm_target) / FASTEST, -1.0, 1.0)
        return actions


def rest_error(arm: FloatArray) -> FloatArray:
    """Return joint angles of rest minus `arm`, the shorter way round for unlimited joints. Shape (n, joints)."""
    error = ROBOT.rest_arm - arm
    error[:, ROBOT.continuous] = wrap(error[:, ROBOT.continuous])
    return error
