"""Many simulators, stepped together in a pool of threads: for training, oracle and execution."""

from __future__ import annotations

import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import ArrayLike

from perdure.errors import PerdureError
from perdure.home.sim.arrays import BoolArray, FloatArray, IntArray
from perdure.home.sim.objects import Placement
from perdure.home.sim.pieces import Pose
from perdure.home.sim.robot import ARM_HIGH, ARM_LOW, REST_ARM
from perdure.home.sim.scene import Scene
from perdure.home.sim.sensors import (
    NO_SCAN,
    Neighbors,
    Outlines,
    PrivilegedState,
    Readings,
    SkillGoal,
    Surroundings,
    no_neighbors,
)
from perdure.home.sim.simulator import (
    ACTION_SIZE,
    ARM,
    ARM_FROM,
    ARM_STEP,
    ARM_TO,
    BASE_SPEED,
    FORWARD,
    GRIP,
    STOP,
    STOP_LEVEL,
    TURN,
    Simulator,
)

CELLS_AHEAD = 10
"""Look-ahead of the waypoint in cells of 0.05 m."""


MAX_IDLE = 512
"""Simulators kept for scenes that were left, about a megabyte each."""


_Start = tuple[Pose, FloatArray, Mapping[str, float], Mapping[int, Placement], int]

_NOWHERE: _Start = (Pose(0.0, 0.0, 0.0), np.array(REST_ARM), {}, {}, -1)


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
        self._threads = min(lanes, threads or len(os.sched_getaffinity(0)))
        self._pool = ThreadPoolExecutor(self._threads) if self._threads > 1 else None
        self._simulators: list[Simulator | None] = [None] * lanes
        self._idle: dict[Scene, list[Simulator]] = {}
        self._idle_count = 0
        self._starts: list[_Start] = [_NOWHERE] * lanes
        self._skill_goal = [SkillGoal()] * lanes
        self._readings = Readings(lanes)
        self._outlines = Outlines(lanes)
        self._surroundings = Surroundings(lanes)
        self._ahead: list[tuple[float, float, float] | None] = [None] * lanes
        """Result of `Geodesic.ahead` for the skill goal's route at the present base pose; None when not computed."""

    def reset(
        self,
        lane: int,
        scene: Scene,
        base: Pose,
        arm: ArrayLike = REST_ARM,
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
            arm: Its arm's joint angles. Shape (7,).
            opened: Joint positions of drawers and doors by link name in place of the scene's own.
            held: Number of the object in the gripper, -1 for none.
            skill_goal: The goal of its skill.
            moved: Placements of objects by number in place of the scene's own.
        """
        old = self._simulators[lane]
        if old is None or old.scene is not scene:
            self._simulators[lane] = self._simulator_of(scene)
            if old is not None:
                self._keep(old)
        self._starts[lane] = (base, np.array(arm, dtype=np.float64), dict(opened or {}), dict(moved or {}), held)
        self._skill_goal[lane] = skill_goal or SkillGoal()
        self._begin(lane)

    def assign(self, lane: int, skill_goal: SkillGoal) -> None:
        """Give a lane another skill goal."""
        self._skill_goal[lane] = skill_goal
        self._take_skill_goal(lane)

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
            actions: From -1 to 1, see `actions`; values outside are clipped. Shape (m, 11).
            lanes: Which lanes to step, all when None. Shape (m,).
            base_speed: Speed of a base action of 1 in [m/s] and [rad/s]. Shape (m,).
            arm_step: What an arm action of 1 adds to a servo's target in [rad]. Shape (m,).

        Raises:
            PerdureError: If a shape does not fit or an action is not a finite number.
        """
        chosen = np.arange(self.num_lanes) if lanes is None else lanes
        clipped = self._checked(actions, chosen)
        self._command(chosen, clipped, np.broadcast_to(base_speed, len(chosen)), np.broadcast_to(arm_step, len(chosen)))
        if self._pool is None or len(chosen) == 1:
            self._step_some(chosen)
        else:
            parts = [chosen[k :: self._threads] for k in range(self._threads)]
            list(self._pool.map(self._step_some, parts))
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
        chosen = np.arange(self.num_lanes) if lanes is None else lanes
        reach, look = np.broadcast_to(scan_reach, len(chosen)), np.broadcast_to(neighbors, len(chosen))
        way, waypoint = self._ways(chosen)
        return self._readings.state(chosen, way, waypoint, self._scan(chosen, reach), self._look_around(chosen, look))

    def objects(self, lanes: IntArray, count: int) -> tuple[FloatArray, FloatArray]:
        """Return poses (position, quaternion) and velocities of the first objects: (m, count, 7), (m, count, 3)."""
        poses, speeds = np.empty((len(lanes), count, 7)), np.empty((len(lanes), count, 3))
        for row, number in enumerate(map(int, lanes)):
            simulator = self.simulator(number)
            poses[row] = simulator.qpos[simulator.scene.poses[:count]]
            speeds[row] = simulator.qvel[simulator.scene.velocities[:count]]
        return poses, speeds

    def close(self) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def _simulator_of(self, scene: Scene) -> Simulator:
        """Return a simulator of a scene: one that was left, or a new one."""
        idle = self._idle.get(scene)
        if not idle:
            return Simulator(scene)
        self._idle_count -= 1
        simulator = idle.pop()
        if not idle:
            del self._idle[scene]
        return simulator

    def _keep(self, simulator: Simulator) -> None:
        """Keep a simulator for its scene's next episode; of too many, those of the scene longest unused go."""
        self._idle[simulator.scene] = [*self._idle.pop(simulator.scene, []), simulator]
        self._idle_count += 1
        if self._idle_count > MAX_IDLE:
            oldest = next(iter(self._idle))
            self._idle_count -= len(self._idle.pop(oldest))

    def _begin(self, number: int) -> None:
        base, arm, opened, moved, held = self._starts[number]
        simulator = self.simulator(number)
        simulator.reset(base, arm, opened, moved)
        readings = self._readings
        readings.arm_target[number] = arm
        readings.force[number] = 0.0
        self._take_skill_goal(number)
        self._read(np.array([number]), first=True)
        if held >= 0:
            simulator.hold_object(held, simulator.gripper, simulator.gripper_axes)
            simulator.forward()
            readings.read_skill_goal(number, simulator)

    def _checked(self, actions: FloatArray, chosen: IntArray) -> FloatArray:
        actions = np.asarray(actions, dtype=np.float64)
        if actions.shape != (len(chosen), ACTION_SIZE):
            raise PerdureError(f"actions have shape {actions.shape}; it must be {(len(chosen), ACTION_SIZE)}")
        if not np.isfinite(actions).all():
            raise PerdureError(
                f"actions must be finite; those of lanes {chosen[~np.isfinite(actions).all(axis=1)]} are not"
            )
        return np.clip(actions, -1.0, 1.0)

    def _command(self, chosen: IntArray, actions: FloatArray, speed: FloatArray, arm_step: FloatArray) -> None:
        readings = self._readings
        target = np.clip(readings.arm_target[chosen] + arm_step[:, None] * actions[:, ARM], ARM_LOW, ARM_HIGH)
        readings.arm_target[chosen] = target
        grip = actions[:, GRIP]
        stopped = actions[:, STOP] > STOP_LEVEL
        readings.stopped[chosen] = stopped
        speed = np.where(stopped, 0.0, speed)
        forward, turning = actions[:, FORWARD] * speed, actions[:, TURN] * speed
        for row, number in enumerate(chosen):
            simulator = self.simulator(number)
            if grip[row] > 0.0:
                simulator.grasp(simulator.gripper, simulator.gripper_axes, self._handle_points(number))
            elif grip[row] < 0.0:
                simulator.release()
            simulator.ctrl[ARM_FROM:ARM_TO] = target[row]
            simulator.drive(forward[row], turning[row])

    def _step_some(self, chosen: IntArray) -> None:
        for number in chosen:
            simulator = self.simulator(number)
            simulator.step()
            self._readings.force[number] = simulator.robot_force()

    def _read(self, chosen: IntArray, first: bool = False) -> None:
        readings = self._readings
        readings.diverged[chosen] = False
        for number in map(int, chosen):
            simulator = self.simulator(number)
            self._ahead[number] = None
            if not first and simulator.diverged():
                self._begin(number)
                readings.diverged[number] = True
            readings.read_robot(number, simulator)
        readings.move_grippers(chosen, readings.diverged[chosen] | first)
        for number in map(int, chosen):
            readings.read_skill_goal(number, self.simulator(number))

    def _take_skill_goal(self, number: int) -> None:
        self._ahead[number] = None
        self._readings.take_skill_goal(number, self.simulator(number), self._skill_goal[number])

    def _handle_points(self, number: int) -> FloatArray:
        simulator = self.simulator(number)
        return simulator.scene.handles.at(simulator.qpos[simulator.scene.link_qpos])

    def _ways(self, chosen: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the path length to each skill goal and a waypoint ahead; 0 and the base where there is no route."""
        way, waypoint = np.zeros(len(chosen)), np.zeros((len(chosen), 3))
        waypoint[:, :2] = self._readings.robot[chosen, :2]
        for row, number in enumerate(chosen.tolist()):
            route = self._skill_goal[number].route
            if route is not None:
                known = self._ahead[number]
                if known is None:
                    x, y = waypoint[row, :2].tolist()
                    known = self._ahead[number] = route.ahead(x, y, CELLS_AHEAD)
                way[row], waypoint[row, 0], waypoint[row, 1] = known
        return way, waypoint

    def _scan(self, chosen: IntArray, reach: FloatArray) -> FloatArray:
        ranges = np.tile(NO_SCAN, (len(chosen), 1))
        for number in chosen[reach > 0.0].tolist():
            simulator = self.simulator(number)
            self._outlines.renew(number, simulator.scene.apartment, simulator.links)
        for each in np.unique(reach[reach > 0.0]).tolist():  # who looks far must not make the others' search longer
            rows = np.flatnonzero(reach == each)
            ranges[rows] = self._outlines.scan(chosen[rows], self._readings.robot[chosen[rows], :3], each)
        return ranges

    def _look_around(self, chosen: IntArray, look: BoolArray) -> Neighbors:
        around, rows = no_neighbors(len(chosen)), np.flatnonzero(look)
        if len(rows):
            readings, numbers = self._readings, chosen[rows]
            lanes = [self.simulator(number) for number in numbers.tolist()]
            found = self._surroundings.look(numbers, lanes, readings.skill_goal[numbers, 0], readings.gripper[numbers])
            for kept, seen in zip(around, found, strict=True):
                kept[rows] = seen
        return around
