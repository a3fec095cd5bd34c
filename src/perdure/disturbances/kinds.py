"""The kinds of disturbances that come with perdure: noise, delay, pushes, other physics."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np

from perdure.disturbances.vocabulary import Effect, FloatArray, IntArray
from perdure.errors import PerdureError

PUSH_STEPS = 200
"""Control steps between two pushes."""
PAYLOAD_DISTANCE = 0.1
"""From the root body's center of mass forward [m]."""
BLOCK = 256
"""Steps whose noise is drawn at once."""
REAL_WORLD_RL = "Dulac-Arnold et al. 2020, Real-World RL suite"


class Noise(Effect):
    """Gaussian noise, drawn for `BLOCK` steps of a lane at once."""

    size: int
    """Components of an action or of an observation."""

    def prepare(self) -> None:
        """Make room for the draws."""
        self._drawn = np.zeros((len(self.robots), BLOCK, self.size))

    @abstractmethod
    def spread(self, lane: int) -> FloatArray:
        """Return the standard deviation at level 1, shape (size,)."""

    def draw(self, lanes: IntArray, elapsed: IntArray) -> FloatArray:
        """Return the noise of these steps of these lanes, shape (n, size)."""
        rows = elapsed % BLOCK
        if not rows.all():
            for at in np.flatnonzero(rows == 0):
                lane = int(lanes[at])
                block = int(elapsed[at]) // BLOCK
                normal = self.robots.generator(self.name, lane, block).standard_normal((BLOCK, self.size))
                self._drawn[lane] = self.level * self.spread(lane) * normal
        drawn: FloatArray = self._drawn[lanes, rows]
        return drawn


class ActionNoise(Noise):
    """See `words`."""

    name = "action_noise"
    words = "Gaussian noise on the mean action: standard deviation = level x half the action range; the sum is clipped"
    unit = "of half the action range"
    example = 0.1
    source = REAL_WORLD_RL
    place = 10
    needs_action_box = True

    def prepare(self) -> None:
        """See `Noise.prepare`."""
        self.size = len(self.robots.low)
        self._half = 0.5 * (self.robots.high - self.robots.low)
        super().prepare()

    def spread(self, lane: int) -> FloatArray:
        """Return half the action range."""
        return self._half

    def on_action(self, actions: FloatArray, lanes: IntArray, elapsed: IntArray) -> FloatArray:
        """Return the clipped command plus noise."""
        return self.robots.clip(actions) + self.draw(lanes, elapsed)


class ObservationNoise(Noise):
    """See `words`. A change of the spread acts on the next `BLOCK` steps that are drawn."""

    name = "observation_noise"
    words = "Gaussian noise on each observation component: standard deviation = level x its spread in training"
    unit = "of the spread in training"
    example = 0.05
    source = REAL_WORLD_RL

    def prepare(self) -> None:
        """See `Noise.prepare`."""
        if not self.robots.knows_spread:
            raise PerdureError("observation_noise needs the spread of the observations in training: observation_std")
        self.size = self.robots.observation_std.shape[1]
        super().prepare()

    def spread(self, lane: int) -> FloatArray:
        """Return the spread of each component in training."""
        found: FloatArray = self.robots.observation_std[lane]
        return found

    def on_observation(self, observations: FloatArray, lanes: IntArray, elapsed: IntArray) -> FloatArray:
        """Add noise in place."""
        observations += self.draw(lanes, elapsed)
        return observations


class ActionDelay(Effect):
    """See `words`. It remembers actions before its onset too: the first ones that act late are older ones."""

    name = "action_delay"
    words = "an action acts `level` control steps late; before the first one the action nearest to zero acts"
    unit = "control steps"
    example = 2.0
    source = REAL_WORLD_RL
    place = 20
    needs_action_box = True

    @classmethod
    def check(cls, level: float) -> None:
        """See `Effect.check`."""
        super().check(level)
        if level != int(level):
            raise PerdureError(f"action_delay counts whole control steps, got {level}")

    def prepare(self) -> None:
        """Make a queue for each lane."""
        self._queue = np.zeros((len(self.robots), int(self.level), len(self.robots.low)))

    def on_begin(self, lanes: IntArray) -> None:
        """Fill the queues with the action nearest to zero."""
        self._queue[lanes] = self.robots.neutral_action

    def on_action(self, actions: FloatArray, lanes: IntArray, elapsed: IntArray) -> FloatArray:
        """Return the actions of `level` steps ago."""
        if self.level == 0:
            return actions
        place = elapsed % int(self.level)
        late: FloatArray = self._queue[lanes, place]
        self._queue[lanes, place] = actions
        return late


class Lag(Effect):
    """See `words`."""

    name = "lag"
    words = (
        "slow actuators (first-order low-pass filter): applied action = `level` x the last applied action + "
        "(1 - `level`) x the command"
    )
    unit = "of the last action"
    example = 0.3
    below = 1.0
    place = 30
    needs_action_box = True

    def prepare(self) -> None:
        """Remember the last applied action of each lane."""
        self._applied = np.tile(self.robots.neutral_action, (len(self.robots), 1))

    def on_begin(self, lanes: IntArray) -> None:
        """Begin with the action nearest to zero."""
        self._applied[lanes] = self.robots.neutral_action

    def on_action(self, actions: FloatArray, lanes: IntArray, elapsed: IntArray) -> FloatArray:
        """Return the filtered actions."""
        if self.level == 0:
            return actions
        filtered = self.level * self._applied[lanes] + (1.0 - self.level) * self.robots.clip(actions)
        if self.disturbance.is_timed:  # where it does not act, the command itself is applied
            acts = self.disturbance.acts(elapsed)[:, None]
            self._applied[lanes] = np.where(acts, filtered, self.robots.clip(actions))
        else:
            self._applied[lanes] = filtered
        return filtered


class Push(Effect):
    """See `words`. With an onset the first push comes there; without one after `PUSH_STEPS`."""

    name = "push"
    words = (
        f"every {PUSH_STEPS} control steps the root's velocity along each horizontal axis changes by U(-level, level) "
        "in [m/s]"
    )
    unit = f"m/s, every {PUSH_STEPS} steps"
    example = 0.5
    source = "Rudin et al. 2022, legged_gym"
    place = 60

    @classmethod
    def first_step(cls, onset: int) -> int:
        """See `Effect.first_step`."""
        return onset or PUSH_STEPS

    def prepare(self) -> None:
        """Find the velocities of each root."""
        self._velocities = [horizontal_velocities(each.model) for each in self.robots.simulators]

    def on_state(self, lanes: IntArray, elapsed: IntArray) -> None:
        """Push the robots whose turn it is."""
        onset = self.disturbance.onset
        turn = (elapsed - onset) % PUSH_STEPS
        if turn.all():
            return
        for row in np.flatnonzero((turn == 0) & (elapsed > 0)):
            lane = int(lanes[row])
            numbers = self._velocities[lane]
            draw = self.robots.generator(self.name, lane, int(elapsed[row])).uniform(-1.0, 1.0, len(numbers))
            self.robots.simulators[lane].data.qvel[numbers] += self.level * draw


class Mass(Effect):
    """See `words`."""

    name = "mass"
    words = "mass and inertia of the root body, times `level`"
    unit = "factor"
    example = 1.2
    source = REAL_WORLD_RL
    neutral = 1.0

    def change_model(self, model: Any) -> None:
        """Scale the root body."""
        model.body_mass[1] *= self.level
        model.body_inertia[1] *= self.level


class Friction(Effect):
    """See `words`."""

    name = "friction"
    words = "sliding friction of every contact, times `level`"
    unit = "factor"
    example = 0.8
    source = REAL_WORLD_RL
    neutral = 1.0

    def change_model(self, model: Any) -> None:
        """Scale the friction of geoms and of contact pairs."""
        model.geom_friction[:, 0] *= self.level
        model.pair_friction[:, :2] *= self.level


class Strength(Effect):
    """See `words`."""

    name = "strength"
    words = "torque of every motor, times `level`: its gear, or the gains and the limit of a position controller"
    unit = "factor"
    example = 0.9
    source = "Kumar et al. 2021, RMA"
    neutral = 1.0

    def change_model(self, model: Any) -> None:
        """Scale gears and gains."""
        servo = model.actuator_biastype != 0  # its gear also turns what it measures
        model.actuator_gear[~servo] *= self.level
        for torques in (model.actuator_gainprm, model.actuator_biasprm, model.actuator_forcerange):
            torques[servo] *= self.level


class Payload(Effect):
    """See `words`. Its mass is a share of the root body's after `Mass`."""

    name = "payload"
    words = (
        f"a point mass of `level` times the root body's, fixed {PAYLOAD_DISTANCE:g} m in front of its center of mass"
    )
    unit = "of the root body's mass"
    example = 0.1
    place = 60

    def change_model(self, model: Any) -> None:
        """Give the root body the mass, the center and the inertia of both together."""
        import mujoco

        if self.level == 0:  # the axes below would have another order
            return
        robot = float(model.body_mass[1])
        load = self.level * robot
        axes = np.zeros(9)
        mujoco.mju_quat2Mat(axes, model.body_iquat[1])
        turned = axes.reshape(3, 3)
        # Two point masses turn about their common center with their reduced mass.
        across = np.diag([0.0, 1.0, 1.0]) * PAYLOAD_DISTANCE**2 * robot * load / (robot + load)
        moments, axes = np.linalg.eigh(turned @ np.diag(model.body_inertia[1]) @ turned.T + across)
        axes[:, 2] *= np.linalg.det(axes)
        mujoco.mju_mat2Quat(model.body_iquat[1], axes.ravel())
        model.body_inertia[1] = moments
        model.body_mass[1] = robot + load
        model.body_ipos[1, 0] += PAYLOAD_DISTANCE * load / (robot + load)


class Slope(Effect):
    """See `words`."""

    name = "slope"
    words = "gravity tilts by `level` degrees, as if the robot walked uphill along its x axis"
    unit = "degrees"
    example = 3.0

    def change_model(self, model: Any) -> None:
        """Turn gravity."""
        angle = np.radians(self.level)
        down = float(np.linalg.norm(model.opt.gravity))
        model.opt.gravity[:] = -down * np.sin(angle), 0.0, -down * np.cos(angle)


class TimeStep(Effect):
    """See `words`."""

    name = "time_step"
    words = "physics steps of `level` times the length, and so many more of them to a control step"
    unit = "factor"
    example = 0.5
    neutral = 1.0
    no_time = "the number of physics steps to a control step belongs to the environment"

    @classmethod
    def check(cls, level: float) -> None:
        """See `Effect.check`."""
        super().check(level)
        if level == 0.0:
            raise PerdureError("the level of time_step must be more than 0, got 0")

    def prepare(self) -> None:
        """Change the number of physics steps to a control step."""
        for each in self.robots.simulators:
            steps = each.env.frame_skip
            each.env.frame_skip = round(steps / self.level)
            if abs(each.env.frame_skip * self.level - steps) > 1e-3 * steps:  # another control rate
                raise PerdureError(
                    f"{self.robots.name}: {self.disturbance.label} is not {steps} divided by a whole number"
                )

    def change_model(self, model: Any) -> None:
        """Scale the physics step."""
        model.opt.timestep *= self.level


def horizontal_velocities(model: Any) -> IntArray:
    """Return the numbers in `qvel` of the velocities of a model's root, its first body, along x and y.

    Planar robots have one. PerdureError if the root does not move.
    """
    import mujoco

    numbers: list[int] = []
    for joint in np.flatnonzero(model.jnt_bodyid == 1):
        first = int(model.jnt_dofadr[joint])
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            numbers += [first, first + 1]
        elif model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE and abs(model.jnt_axis[joint][2]) < 0.5:
            numbers.append(first)
    if not numbers:
        raise PerdureError("the robot's root does not move, so it cannot be pushed")
    return np.array(numbers)


def root_velocity(model: Any, change: FloatArray) -> FloatArray:
    """Return what a change of `qvel` means for the horizontal velocity of a model's root, shape (3,)."""
    import mujoco

    total = np.zeros(3)
    for number in horizontal_velocities(model):
        joint = model.dof_jntid[number]
        axis = model.jnt_axis[joint]
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            axis = np.eye(3)[number - model.jnt_dofadr[joint]]
        total += change[number] * axis
    return total
