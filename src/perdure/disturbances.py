"""Disturbances of a robot, declared like clocks: ``action_noise:0.1``, ``push:0.5``.

What an episode meets depends on its seed, the disturbance and the step alone: policies that start from the same seed
meet the same draws, whatever runs beside them. `perdure.envs.disturbances.DisturbedWorld` applies them to a world, and
`perdure.wrappers.Disturb` to an environment of Gymnasium.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from perdure.errors import PerdureError, lookup

FloatArray: TypeAlias = npt.NDArray[np.float64]
IntArray: TypeAlias = npt.NDArray[np.int64]
PUSH_STEPS = 200
"""Control steps between two pushes."""
PAYLOAD_DISTANCE = 0.1
"""From the root body's center of mass forward [m]."""
BLOCK = 256
"""Steps whose noise is drawn at once."""
KINDS = {
    "action_noise": "Gaussian noise on the mean action: standard deviation = level x half the action range; the sum is "
    "clipped",
    "observation_noise": "Gaussian noise on each observation component: standard deviation = level x its spread in "
    "training",
    "action_delay": "an action acts `level` control steps late; before the first one the action nearest to zero acts",
    "push": "every 200 control steps the root's velocity along each horizontal axis changes by U(-level, level) in "
    "[m/s]",
    "mass": "mass and inertia of the root body, times `level`",
    "friction": "sliding friction of every contact, times `level`",
    "strength": "torque of every motor, times `level`: its gear, or the gains and the limit of a position controller",
    "lag": "slow actuators (first-order low-pass filter): applied action = `level` x the last applied action + "
    "(1 - `level`) x the command",
    "payload": "a point mass of `level` times the root body's, fixed 0.1 m in front of its center of mass",
    "slope": "gravity tilts by `level` degrees, as if the robot walked uphill along its x axis",
    "time_step": "physics steps of `level` times the length, and so many more of them to a control step",
}
"""What each kind of disturbance does."""
CALM = "none"
"""Name of no disturbance at all, also in tables."""
STANDARDS: dict[str, tuple[str, ...]] = {
    "standard-1": (
        "action_noise:0.02",
        "observation_noise:0.01",
        "push:0.1",
        "mass:1.05",
        "friction:0.95",
        "strength:0.95",
    )
}
"""Disturbances that act together under one name, which always means the same ones: 1 or 2 % noise, 5 % error in the
model, small pushes. The levels are mild beside what the Real-World RL suite (Dulac-Arnold et al. 2020), RRLS and
Robust-Gymnasium vary. They were chosen, on start states that no study uses, so that some policies pass: at twice these
levels no run of ten Hoppers with a time-to-go did. No delay: a control step is 8 ms on Hopper and 50 ms on HalfCheetah,
and one step of delay is too much for nearly every policy trained without."""
STANDARD = "standard-1"
"""What an evaluation applies if nothing else is asked for."""
NEED_SIMULATOR = ("push", "mass", "friction", "strength", "payload", "slope", "time_step")
"""Kinds that change MuJoCo's model or state."""
FACTORS = ("mass", "friction", "strength", "time_step")
"""Kinds whose level 1 changes nothing; that of the others is 0."""


@dataclass(frozen=True)
class Disturbance:
    """One way to disturb a robot, at one level.

    Raises:
        PerdureError: If there is no such kind, or the level means nothing.
    """

    name: str
    """A key of `KINDS`."""
    level: float

    def __post_init__(self) -> None:
        lookup(KINDS, self.name, "disturbance")
        if not 0.0 <= self.level < np.inf:
            raise PerdureError(f"the level of {self.name} must be 0 or more, got {self.level}")
        if self.name == "action_delay" and self.level != int(self.level):
            raise PerdureError(f"action_delay counts whole control steps, got {self.level}")
        if self.name == "lag" and self.level >= 1.0:
            raise PerdureError(f"the level of lag must be less than 1, got {self.level}")
        if self.name == "time_step" and self.level == 0.0:
            raise PerdureError("the level of time_step must be more than 0, got 0")

    @property
    def label(self) -> str:
        """The text that `parse_disturbance` reads, such as ``push:0.5``."""
        return f"{self.name}:{self.level:g}"


def parse_disturbance(text: str) -> Disturbance:
    """Return the disturbance of a text such as ``push:0.5``; PerdureError if it names none, or no level in range."""
    name, _, level = text.strip().partition(":")
    try:
        number = float(level)
    except ValueError:
        raise PerdureError(
            f"a disturbance is written name:level, for example push:0.5, or one of {', '.join(STANDARDS)}, or {CALM} "
            f"alone; got {text!r}"
        ) from None
    return Disturbance(name, number)


def parse_disturbances(texts: Sequence[str]) -> tuple[Disturbance, ...]:
    """Return disturbances that act together, in one order; none for "none", and all of a name in `STANDARDS`.

    Raises:
        PerdureError: If a text names none, or a kind is named twice.
    """
    if tuple(texts) == (CALM,):
        return ()
    if CALM in texts:
        raise PerdureError(f"{CALM} cannot be combined with disturbances: {' '.join(texts)}")
    found = [parse_disturbance(each) for text in texts for each in STANDARDS.get(text, (text,))]
    if len({each.name for each in found}) < len(found):
        raise PerdureError(f"one kind of disturbance is named twice: {', '.join(each.label for each in found)}")
    return tuple(sorted(found, key=lambda each: each.name))


def labels(disturbances: Sequence[Disturbance]) -> str:
    """Return how tables name disturbances that act together: "action_noise:0.1 push:0.5"."""
    return " ".join(each.label for each in disturbances) or CALM


class Disturber:
    """What disturbances do to the actions, the robots and the observations of n lanes.

    Call `begin` where an episode begins, `act` before each step, and `observe` for each observation. `box` is the
    lowest and the highest action, each of shape (action_size,), None where actions are not a box; the models of
    `environments`, of Gymnasium's MuJoCo and one for each lane, are changed. An environment that observes the last
    action has the attribute `policy_action`: it gets the policy's own there, since a robot knows no other.

    Raises:
        PerdureError: If a disturbance cannot be applied here.
    """

    observation_std: FloatArray
    """Spread of each observation component in training, shape (n, observation_size); observation noise scales with it.
    A change acts on the next `BLOCK` steps that are drawn."""

    def __init__(
        self,
        name: str,
        disturbances: Sequence[Disturbance],
        seeds: Sequence[int],
        box: tuple[FloatArray, FloatArray] | None,
        observation_std: FloatArray | None,
        environments: Sequence[Any] = (),
    ) -> None:
        self.seeds, self._of = list(seeds), {each.name: each.level for each in disturbances}
        for kind in {"action_noise", "action_delay", "lag"} & self._of.keys():
            if box is None or not np.isfinite(box).all():
                raise PerdureError(f"{kind} needs actions in a finite box, those of {name} are not")
        told = [each for each in environments if hasattr(each.unwrapped, "policy_action")]
        self._told = [each.unwrapped for each in told if each.action_space == each.unwrapped.action_space]
        lanes, (self._low, self._high) = len(self.seeds), (np.zeros(0), np.zeros(0)) if box is None else box
        if "observation_noise" in self._of and observation_std is None:
            raise PerdureError("observation_noise needs the spread of the observations in training: observation_std")
        self.observation_std = np.zeros((lanes, 0)) if observation_std is None else np.array(observation_std, float)
        self._half = 0.5 * (self._high - self._low)
        self._neutral = np.clip(np.zeros(len(self._low)), self._low, self._high)
        widths = {"action_noise": len(self._low), "observation_noise": self.observation_std.shape[1]}
        self._noise = {kind: np.zeros((lanes, BLOCK, size)) for kind, size in widths.items() if kind in self._of}
        self._queue = np.zeros((lanes, int(self._of.get("action_delay", 0)), len(self._low)))
        self._acting = np.tile(self._neutral, (lanes, 1))
        self.episodes = np.zeros(lanes, np.int64)
        """Episodes begun in each lane: each one has its own draws."""
        self._simulators = self._open(name, environments) if set(NEED_SIMULATOR) & self._of.keys() else []

    def begin(self, lanes: IntArray) -> None:
        """Begin an episode in each of these lanes."""
        self.episodes[lanes] += 1
        self._queue[lanes] = self._acting[lanes] = self._neutral

    def act(self, actions: FloatArray, lanes: IntArray, elapsed: IntArray) -> FloatArray:
        """Return the actions that act, still to be clipped; push the robots whose turn it is.

        Args:
            actions: Of the policy, shape (n, action_size).
            lanes: Lane numbers, shape (n,).
            elapsed: Steps before this one, shape (n,).
        """
        for lane, own in zip(lanes, actions, strict=True) if self._told else ():
            self._told[lane].policy_action = own.clip(self._low, self._high)
        if "action_noise" in self._of:
            actions = np.minimum(np.maximum(actions, self._low), self._high)
            actions += self._draw("action_noise", lanes, elapsed)
        if delay := self._queue.shape[1]:
            place = elapsed % delay
            late = self._queue[lanes, place]
            self._queue[lanes, place] = actions
            actions = late
        if lag := self._of.get("lag", 0.0):
            actions = np.minimum(np.maximum(actions, self._low), self._high)
            actions = self._acting[lanes] = lag * self._acting[lanes] + (1.0 - lag) * actions
        if "push" in self._of and not (turn := elapsed % PUSH_STEPS).all():
            for row in np.flatnonzero((turn == 0) & (elapsed > 0)):
                data, numbers = self._simulators[lanes[row]]
                draw = self._generator("push", lanes[row], int(elapsed[row])).uniform(-1.0, 1.0, len(numbers))
                data.qvel[numbers] += self._of["push"] * draw
        return actions

    def observe(self, observations: FloatArray, lanes: IntArray, elapsed: IntArray) -> FloatArray:
        """Return the observations that the policy gets.

        Args:
            observations: Of the world, shape (n, observation_size); changed in place.
            lanes: Lane numbers, shape (n,).
            elapsed: Steps since reset, shape (n,).
        """
        if "observation_noise" in self._of:
            observations += self._draw("observation_noise", lanes, elapsed)
        return observations

    def _generator(self, kind: str, lane: int, block: int) -> np.random.Generator:
        key = [self.seeds[lane], zlib.crc32(kind.encode()), int(self.episodes[lane]), block]
        return np.random.Generator(np.random.Philox(np.random.SeedSequence(key)))

    def _draw(self, kind: str, lanes: IntArray, steps: IntArray) -> FloatArray:
        """Return the noise for these steps of these lanes, shape (n, width)."""
        block, row = self._noise[kind], steps % BLOCK
        for at in () if row.all() else np.flatnonzero(row == 0):
            scale = self._half if kind == "action_noise" else self.observation_std[lanes[at]]
            generator = self._generator(kind, lanes[at], int(steps[at]) // BLOCK)
            block[lanes[at]] = self._of[kind] * scale * generator.standard_normal(block.shape[1:])
        drawn: FloatArray = block[lanes, row]
        return drawn

    def _open(self, name: str, environments: Sequence[Any]) -> list[tuple[Any, IntArray]]:
        """Change the models' factors; return (data, numbers of the root's horizontal velocities) of each lane."""
        import mujoco

        found = []
        for env in environments:
            model, data = getattr(env.unwrapped, "model", None), getattr(env.unwrapped, "data", None)
            if isinstance(model, mujoco.MjModel) and isinstance(data, mujoco.MjData):
                change_model(model, self._of)
                if level := self._of.get("time_step"):
                    steps = env.unwrapped.frame_skip
                    env.unwrapped.frame_skip = round(steps / level)
                    if abs(env.unwrapped.frame_skip * level - steps) > 1e-3 * steps:  # another control rate
                        raise PerdureError(f"{name}: time_step:{level:g} is not {steps} divided by a whole number")
                if {"mass", "payload"} & self._of.keys():
                    mujoco.mj_setConst(model, data)  # quantities that MuJoCo derives from masses
                found.append((data, horizontal_velocities(model) if "push" in self._of else np.zeros(0, np.int64)))
        if len(found) < len(self.seeds):
            kinds = ", ".join(kind for kind in NEED_SIMULATOR if kind in self._of)
            raise PerdureError(
                f"{name}: {kinds} needs an environment of Gymnasium whose `unwrapped` has MuJoCo's `model` and `data`, "
                "such as gymnasium:Hopper-v5"
            )
        return found


def change_model(model: Any, levels: Mapping[str, float]) -> None:
    """Change a model of MuJoCo by the factors, payload, slope and time step among the levels of kinds."""
    model.body_mass[1] *= levels.get("mass", 1.0)
    model.body_inertia[1] *= levels.get("mass", 1.0)
    model.geom_friction[:, 0] *= levels.get("friction", 1.0)
    model.pair_friction[:, :2] *= levels.get("friction", 1.0)
    servo, strength = model.actuator_biastype != 0, levels.get("strength", 1.0)  # its gear also turns what it measures
    model.actuator_gear[~servo] *= strength
    for torques in (model.actuator_gainprm, model.actuator_biasprm, model.actuator_forcerange):
        torques[servo] *= strength
    model.opt.timestep *= levels.get("time_step", 1.0)
    if "slope" in levels:
        angle, down = np.radians(levels["slope"]), float(np.linalg.norm(model.opt.gravity))
        model.opt.gravity[:] = -down * np.sin(angle), 0.0, -down * np.cos(angle)
    if "payload" in levels:
        import mujoco

        robot, load = float(model.body_mass[1]), levels["payload"] * float(model.body_mass[1])
        axes = np.zeros(9)
        mujoco.mju_quat2Mat(axes, model.body_iquat[1])
        turned = axes.reshape(3, 3)
        # Two point masses turn about their common center with their reduced mass.
        across = np.diag([0.0, 1.0, 1.0]) * PAYLOAD_DISTANCE**2 * robot * load / (robot + load)
        moments, axes = np.linalg.eigh(turned @ np.diag(model.body_inertia[1]) @ turned.T + across)
        axes[:, 2] *= np.linalg.det(axes)
        mujoco.mju_mat2Quat(model.body_iquat[1], axes.ravel())
        model.body_inertia[1], model.body_mass[1] = moments, robot + load
        model.body_ipos[1, 0] += PAYLOAD_DISTANCE * load / (robot + load)


def horizontal_velocities(model: Any) -> IntArray:
    """Return the numbers in `qvel` of the velocities of a model's root, its first body, along x and y.

    Planar robots have one. PerdureError if the root does not move.
    """
    import mujoco

    numbers = list[int]()
    for joint in np.flatnonzero(model.jnt_bodyid == 1):
        first = int(model.jnt_dofadr[joint])
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            numbers += [first, first + 1]
        elif model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE and abs(model.jnt_axis[joint][2]) < 0.5:
            numbers.append(first)
    if not numbers:
        raise PerdureError("the robot's root does not move, so it cannot be pushed")
    return np.array(numbers)
