"""Pick: grasp the target and bring the gripper back to its rest position."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from perdure.home.sim.world import GRIP, NEIGHBORHOOD, NEIGHBORS, PrivilegedState
from perdure.home.sim.world.state import norm
from perdure.home.skills.observation import (
    CLOSENESS,
    PROPRIOCEPTION,
    REACHING,
    closeness,
    point,
    point_elements,
    proprioception,
    reaching,
)
from perdure.home.skills.skill import RETRACTED, Element, Progress, Skill, first_of, invalid_grasp, rest_distance

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

DISTANCE_REWARD = 4.0
GRASP_REWARD = 1.0
LEAD = 0.3
"""Leads beyond it look alike, in [m]."""


@dataclass(frozen=True)
class Pick(Skill):
    """Reward (M3): 4 per meter nearer to the object, once it is held 4 per meter nearer to rest, +1 for the grasp."""

    name = "pick"
    failures: ClassVar[tuple[str, ...]] = ("none", "wrong object", "dropped", "invalid grasp", "excess force")
    force_limit = 5000.0
    needs_neighbors = True

    @property
    def elements(self) -> tuple[Element, ...]:
        """See `Skill.elements`."""
        return (
            *PROPRIOCEPTION,
            *CLOSENESS,
            *REACHING,
            *point_elements("object", "the object"),
            *(
                Element(f"neighbor_{k}_{a}", f"from the object to its neighbor {k}, base axes {a}, 0 without one", "m")
                for k in range(NEIGHBORS)
                for a in "xyz"
            ),
            *(
                Element(
                    f"neighbor_{k}_near", f"nearness of neighbor {k}: 1 at the object, 0 from 0.5 m on", "1", 0.0, 1.0
                )
                for k in range(NEIGHBORS)
            ),
            Element("lead", "by how much the object is nearer to the gripper point than others", "m", -LEAD, LEAD),
            Element("handle_distance", "from the gripper point to the nearest handle", "m", 0.0, NEIGHBORHOOD),
            Element("holding", "1 when something is held", "1", 0.0, 1.0),
        )

    def observe(self, state: PrivilegedState, progress: Progress) -> FloatArray:
        """See `Skill.observe`."""
        holding = (state.held >= 0).astype(np.float64)[:, None]
        columns = [*proprioception(state), closeness(state), *reaching(state, progress, self.force_limit)]
        columns += point(state, state.object)
        return np.concatenate([*columns, *neighbors(state), holding], axis=1)

    def terms(
        self, before: PrivilegedState, after: PrivilegedState, was: Progress, now: Progress
    ) -> Mapping[str, FloatArray]:
        """See `Skill.terms`."""
        approach = norm(before.object - before.gripper) - norm(after.object - after.gripper)
        retract = rest_distance(before) - rest_distance(after)
        held_before = before.holds_target
        return {
            # In the step of the grasp the object jumps into the gripper: that is no approach.
            "approach": DISTANCE_REWARD * np.where(before.empty_hand & after.empty_hand, approach, 0.0),
            "retract": DISTANCE_REWARD * np.where(held_before & after.holds_target, retract, 0.0),
            "grasp": np.where(now.grasped & ~was.grasped, GRASP_REWARD, 0.0),
        }

    def success(self, state: PrivilegedState, progress: Progress) -> BoolArray:
        """The target is held and the gripper is within 0.05 m of rest."""
        reached: BoolArray = state.holds_target & (rest_distance(state) <= RETRACTED)
        return reached

    def failure(self, state: PrivilegedState, progress: Progress) -> IntArray:
        """See `Skill.failure`."""
        return first_of(
            (state.held >= 0) & ~state.holds_target | (state.held_link >= 0),
            progress.grasped & ~state.holds_target,
            invalid_grasp(state),
            progress.force_sum > self.force_limit,
        )

    def stop(self, state: PrivilegedState, progress: Progress) -> BoolArray:
        """Something (M3: anything) is held and the gripper is back at rest."""
        done: BoolArray = (state.held >= 0) & (rest_distance(state) < RETRACTED)
        return done

    def mask(self, actions: FloatArray, state: PrivilegedState) -> FloatArray:
        """Pick never lets go (M3), and does not close the hand where it would take something else (OURS)."""
        masked = actions.copy()
        masked[:, GRIP] = np.where(state.grasp_is_right, np.maximum(masked[:, GRIP], 0.0), 0.0)
        return masked

    def _remember(self, progress: Progress, state: PrivilegedState) -> Progress:
        progress = super()._remember(progress, state)
        return replace(progress, grasped=progress.grasped | state.holds_target)


def neighbors(state: PrivilegedState) -> list[FloatArray]:
    """What the grasp might take instead. Columns (n, 3) for each neighbor, then (n, NEIGHBORS), (n, 2)."""
    turned = [state.turned_to_base(state.neighbors[:, k]) for k in range(NEIGHBORS)]
    away = np.stack([norm(each) for each in turned], axis=1)
    near = np.where(away > 0.0, np.clip(1.0 - away / NEIGHBORHOOD, 0.0, 1.0), 0.0)
    lead = np.clip(state.neighbor_distance - norm(state.object - state.gripper), -LEAD, LEAD)
    return [*turned, near, np.stack([lead, np.minimum(state.handle_distance, NEIGHBORHOOD)], axis=1)]
