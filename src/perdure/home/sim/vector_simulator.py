"""Many simulators, stepped together in a pool of threads: for training, oracle and execution."""

from __future__ import annotations

import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from perdure.errors import PerdureError
from perdure.home.sim.arrays import BoolArray, FloatArray, IntArray
from perdure.home.sim.objects import Placement
from perdure.home.sim.pieces import Pose
from perdure.home.sim.robot import ROBOT
from perdure.home.sim.scene import CONTROL_HZ, Scene
from perdure.home.sim.sensors import PrivilegedState, SkillGoal, read_state
from perdure.home.sim.simulator import ARM_STEP, BASE_SPEED, STOP_LEVEL, Simulator

MAX_IDLE = 512
"""Simulators kept for scenes that were left, about a megabyte each; the last ones that were left stay."""
_Start = tuple[Pose, FloatArray, Mapping[str, float], Mapping[int, Placement], int]


class VectorSimulator:
    """n lanes, each with a simulator and a skill goal.

    A lane depends on its own scene, start and actions only, not on how many lanes there are or on which
    thread steps it.
    """

    def __init__(self, lanes: int, threads: int | None = None) -> None:
        """Make empty lanes; `reset` fills them.

        Args:
            lanes: How many.
            threads: How many threads step them; the cores this process may use when None.
        """
        if lanes < 1:
            raise PerdureError(f"a simulator needs at least one lane, not {lanes}")
        self.num_lanes = lanes
        self._all = np.arange(lanes)
        self._threads = min(lanes, threads or len(os.sched_getaffinity(0)))
        self._pool: ThreadPoolExecutor | None = None
        if self._threads > 1:
            self._pool = ThreadPoolExecutor(self._threads)
        self._simulators: list[Simulator | None] = [None] * lanes
        self._idle: list[Simulator] = []
        self._starts: dict[int, _Start] = {}
        self._skill_goal = [SkillGoal()] * lanes
        self._known: dict[str, NDArray[Any]] = {
            "arm_target": np.zeros((lanes, len(ROBOT.arm))),
            "gripper": np.zeros((lanes, 3)),
            "gripper_velocity": np.zeros((lanes, 3)),
            "contact_force": np.zeros(lanes),
            "stopped": np.zeros(lanes, dtype=bool),
            "diverged": np.zeros(lanes, dtype=bool),
        }
        """Entries of `PrivilegedState` that a simulator does not tell."""

    def reset(
        self,
        lane: int,
        scene: Scene,
        base: Pose,
        arm: ArrayLike = ROBOT.rest_arm,
        opened: Mapping[str, float] | None = None,
        held: int = -1,
        skill_goal: SkillGoal | None = None,
        moved: Mapping[int, Placement] | None = None,
    ) -> None:
        """Start a lane's episode.

        Args:
            lane: Which lane.
            scene: What it is made of. Simulators of scenes that were left are kept for their next episode.
            base: Where the robot stands.
            arm: Its arm's joint angles. Shape (joints,).
            opened: Joint positions of drawers and doors by link name in place of the scene's own.
            held: Number of the object in the gripper, -1 for none. If `moved` places it, the hand holds it in that
                attitude, else with its axes along the gripper's.
            skill_goal: The goal of its skill.
            moved: Placements of objects by number in place of the scene's own.
        """
        old = self._simulators[lane]
        if old is None or old.scene is not scene:
            self._simulators[lane] = self._simulator_of(scene)
            if old is not None:
                self._idle.append(old)
            del self._idle[:-MAX_IDLE]
        self._starts[lane] = (base, np.array(arm, dtype=np.float64), dict(opened or {}), dict(moved or {}), held)
        self._skill_goal[lane] = skill_goal or SkillGoal()
        self._begin(lane)
        self._known["diverged"][lane] = False

    def assign(self, lane: int, skill_goal: SkillGoal) -> None:
        """Give a lane another skill goal."""
        self._skill_goal[lane] = skill_goal
        self._known["stopped"][lane] = False

    def skill_goal(self, lane: int) -> SkillGoal:
        """Return the skill goal of a lane."""
        return self._skill_goal[lane]

    def simulator(self, number: int) -> Simulator:
        """Return the simulator of a lane, for detailed queries; PerdureError before the lane's first reset."""
        simulator = self._simulators[number]
        if simulator is None:
            raise PerdureError(f"lane {number} was not reset yet")
        return simulator

    def step(
        self,
        actions: FloatArray,
        lanes: IntArray | None = None,
        base_speed: FloatArray | float = BASE_SPEED,
        arm_step: FloatArray | float = ARM_STEP,
    ) -> None:
        """Run one control step: gripper, arm and base commands, then physics (M3's order).

        Args:
            actions: From -1 to 1, see `perdure.home.sim.simulator`; values outside are clipped. Shape (m, action size).
            lanes: Which lanes to step, all when None. Shape (m,).
            base_speed: Speed of a base action of 1 in [m/s] and [rad/s], where the base is so fast. Shape (m,).
            arm_step: What an arm action of 1 adds to a servo's target in [rad]. Shape (m,).

        Raises:
            PerdureError: If a shape does not fit or an action is not a finite number.
        """
        chosen = self._all if lanes is None else lanes
        clipped = self._checked(actions, chosen)
        self._command(chosen, clipped, np.broadcast_to(base_speed, len(chosen)), np.broadcast_to(arm_step, len(chosen)))
        if self._pool is None or len(chosen) == 1:
            self._step_some(chosen)
        else:
            list(self._pool.map(self._step_some, (chosen[k :: self._threads] for k in range(self._threads))))
        self._read(chosen)

    def sense(
        self, lanes: IntArray | None = None, scan_reach: FloatArray | float = 0.0, neighbors: BoolArray | bool = False
    ) -> PrivilegedState:
        """Return the present state of some lanes.

        Args:
            lanes: Which lanes, all when None. Shape (m,).
            scan_reach: Range of each lane's scan in [m]; shorter is faster. Farther obstacles are not
                measured. Shape (m,).
            neighbors: Whether objects and handles around a lane's target are looked for. Shape (m,).
        """
        chosen = self._all if lanes is None else lanes
        return read_state(
            [self.simulator(number) for number in chosen.tolist()],
            [self._skill_goal[number] for number in chosen.tolist()],
            {name: values[chosen] for name, values in self._known.items()},
            np.broadcast_to(scan_reach, len(chosen)),
            np.broadcast_to(neighbors, len(chosen)),
        )

    def close(self) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def _simulator_of(self, scene: Scene) -> Simulator:
        """Return an idle simulator of a scene, a new one when there is none."""
        for number, each in enumerate(self._idle):
            if each.scene is scene:
                return self._idle.pop(number)
        return Simulator(scene)

    def _begin(self, number: int) -> None:
        """Reset a lane's simulator to the start of its episode."""
        base, arm, opened, moved, held = self._starts[number]
        simulator = self.simulator(number)
        simulator.reset(base, arm, opened, moved)
        known = self._known
        known["arm_target"][number] = arm
        known["gripper"][number] = simulator.gripper
        known["gripper_velocity"][number] = 0.0
        known["contact_force"][number] = 0.0
        known["stopped"][number] = False
        if held >= 0:
            simulator.hand.hold_from_start(held, placed=held in moved)

    def _checked(self, actions: FloatArray, chosen: IntArray) -> FloatArray:
        actions = np.asarray(actions, dtype=np.float64)
        if actions.shape != (len(chosen), ROBOT.action_size):
            raise PerdureError(f"actions have shape {actions.shape}; it must be {(len(chosen), ROBOT.action_size)}")
        if not np.isfinite(actions).all():
            raise PerdureError(
                f"actions must be finite; those of lanes {chosen[~np.isfinite(actions).all(axis=1)]} are not"
            )
        return np.clip(actions, -1.0, 1.0)

    def _command(self, chosen: IntArray, actions: FloatArray, speed: FloatArray, arm_step: FloatArray) -> None:
        arm_target = self._known["arm_target"]
        target = arm_target[chosen] + arm_step[:, None] * actions[:, ROBOT.action.arm]
        target = np.clip(target, ROBOT.arm_low, ROBOT.arm_high)
        arm_target[chosen] = target
        grip = actions[:, ROBOT.action.grip]
        stopped = actions[:, ROBOT.action.stop] > STOP_LEVEL
        self._known["stopped"][chosen] = stopped
        fastest = np.array([self.simulator(number).scene.options.base_speed for number in chosen.tolist()])
        speed = np.where(stopped, 0.0, np.minimum(speed, fastest))
        forward = actions[:, ROBOT.action.forward] * speed
        turning = actions[:, ROBOT.action.turn] * speed
        for row, number in enumerate(chosen):
            simulator = self.simulator(number)
            if grip[row] > 0.0:
                simulator.grasp()
            elif grip[row] < 0.0:
                simulator.release()
            simulator.ctrl[ROBOT.arm_columns] = target[row]
            simulator.drive(forward[row], turning[row])

    def _step_some(self, chosen: IntArray) -> None:
        for number in chosen:
            simulator = self.simulator(number)
            simulator.step()
            self._known["contact_force"][number] = simulator.robot_force()

    def _read(self, chosen: IntArray) -> None:
        """Take over where the grippers are now; begin lanes anew that have diverged."""
        known = self._known
        for number in chosen.tolist():
            simulator = self.simulator(number)
            diverged = simulator.diverged()
            known["diverged"][number] = diverged
            if diverged:
                self._begin(number)
            else:
                known["gripper_velocity"][number] = (simulator.gripper - known["gripper"][number]) * CONTROL_HZ
                known["gripper"][number] = simulator.gripper
