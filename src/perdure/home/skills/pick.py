"""Pick: grasp the target and bring the gripper back to its rest position."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from perdure.home.sim.world import GRIP, NEIGHBORHOOD, RIVALS, Sensors
from perdure.home.sim.world.sensors import norm
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
    needs_rivals = True

    @property
    def elements(self) -> tuple[Element, ...]:
        """See `Skill.elements`."""
        return (
            *PROPRIOCEPTION,
            *CLOSENESS,
            *REACHING,
            *point_elements("object", "the object"),
            *(
                Element(f"rival_{k}_{a}", f"from the object to its neighbor {k}, base axes {a}, 0 without one", "m")
                for k in range(RIVALS)
                for a in "xyz"
            ),
            *(
                Element(f"rival_{k}_near", f"nearness of neighbor {k}: 1 at the object, 0 from 0.5 m on", "1", 0.0, 1.0)
                for k in range(RIVALS)
            ),
            Element("lead", "by how much the object is nearer to the gripper point than others", "m", -LEAD, LEAD),
            Element("handle_distance", "from the gripper point to the nearest handle", "m", 0.0, NEIGHBORHOOD),
            Element("holding", "1 when something is held", "1", 0.0, 1.0),
        )

    def observe(self, sensors: Sensors, progress: Progress) -> FloatArray:
        """See `Skill.observe`."""
        holding = (sensors.held >= 0).astype(np.float64)[:, None]
        columns = [*proprioception(sensors), closeness(sensors), *reaching(sensors, progress, self.force_limit)]
        columns += point(sensors, sensors.object)
        return np.concatenate([*columns, *rivals(sensors), holding], axis=1)

    def terms(self, before: Sensors, after: Sensors, was: Progress, now: Progress) -> Mapping[str, FloatArray]:
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

    def success(self, sensors: Sensors, progress: Progress) -> BoolArray:
        """The target is held and the gripper is within 0.05 m of rest."""
        reached: BoolArray = sensors.holds_target & (rest_distance(sensors) <= RETRACTED)
        return reached

    def failure(self, sensors: Sensors, progress: Progress) -> IntArray:
        """See `Skill.failure`."""
        return first_of(
            (sensors.held >= 0) & ~sensors.holds_target | (sensors.held_link >= 0),
            progress.grasped & ~sensors.holds_target,
            invalid_grasp(sensors),
            progress.force_sum > self.force_limit,
        )

    def stop(self, sensors: Sensors, progress: Progress) -> BoolArray:
        """Something (M3: anything) is held and the gripper is back at rest."""
        done: BoolArray = (sensors.held >= 0) & (rest_distance(sensors) < RETRACTED)
        return done

    def mask(self, actions: FloatArray, sensors: Sensors) -> FloatArray:
        """Pick never lets go (M3), and does not close the hand where it would take something else (OURS)."""
        masked = actions.copy()
        masked[:, GRIP] = np.where(sensors.grasp_is_right, np.maximum(masked[:, GRIP], 0.0), 0.0)
        return masked

    def _remember(self, progress: Progress, sensors: Sensors) -> Progress:
        progress = super()._remember(progress, sensors)
        return replace(progress, grasped=progress.grasped | sensors.holds_target)


def rivals(sensors: Sensors) -> list[FloatArray]:
    """What the grasp might take instead of the object. Columns (n, 3) for each rival, then (n, RIVALS), (n, 2)."""
    turned = [sensors.turned_to_base(sensors.rivals[:, k]) for k in range(RIVALS)]
    away = np.stack([norm(each) for each in turned], axis=1)
    near = np.where(away > 0.0, np.clip(1.0 - away / NEIGHBORHOOD, 0.0, 1.0), 0.0)
    lead = np.clip(sensors.rival_distance - norm(sensors.object - sensors.gripper), -LEAD, LEAD)
    return [*turned, near, np.stack([lead, np.minimum(sensors.handle_distance, NEIGHBORHOOD)], axis=1)]
