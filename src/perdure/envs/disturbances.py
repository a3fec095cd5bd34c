"""Disturbances of a deployed robot, declared like clocks: ``action_noise:0.1``, ``push:0.5``.

`DisturbedWorld` adds them to any world. What an episode meets depends on its seed, the disturbance and the step alone:
policies that start from the same seed meet the same draws, whatever runs beside them.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from perdure.envs.gymnasium import GymnasiumWorld
from perdure.envs.world import FloatArray, IntArray, Step, TaskSpec, World
from perdure.errors import PerdureError
from perdure.horizon import Registered

BLOCK = 256
"""Steps whose noise is drawn at once."""


@dataclass(frozen=True)
class Disturbance(Registered):
    """One way to disturb a robot, at one level."""

    level: float
    needs_simulator: ClassVar[bool] = False
    """It changes MuJoCo's model or state: only worlds of Gymnasium's MuJoCo environments can."""

    def __post_init__(self) -> None:
        """Refuse levels that mean nothing."""
        if not 0.0 <= self.level < np.inf:
            raise PerdureError(f"the level of {self.name} must be 0 or more, got {self.level}")

    @property
    def label(self) -> str:
        """The text that `parse_disturbance` reads, such as ``push:0.5``."""
        return f"{self.name}:{self.level:g}"


@dataclass(frozen=True)
class ActionNoise(Disturbance):
    """Gaussian noise on the mean action: standard deviation = level x half the action range; the sum is clipped."""

    name: ClassVar[str] = "action_noise"


@dataclass(frozen=True)
class ObservationNoise(Disturbance):
    """Gaussian noise on each observation component: standard deviation = level x its spread in training."""

    name: ClassVar[str] = "observation_noise"


@dataclass(frozen=True)
class ActionDelay(Disturbance):
    """An action acts `level` control steps late; before the first one the action nearest to zero acts."""

    name: ClassVar[str] = "action_delay"

    def __post_init__(self) -> None:
        """Refuse parts of a step."""
        super().__post_init__()
        if self.level != int(self.level):
            raise PerdureError(f"action_delay counts whole control steps, got {self.level}")


@dataclass(frozen=True)
class Push(Disturbance):
    """Every `PUSH_STEPS` steps the root's velocity along each horizontal axis changes by U(-level, level) in [m/s]."""

    name: ClassVar[str] = "push"
    needs_simulator: ClassVar[bool] = True


@dataclass(frozen=True)
class Mass(Disturbance):
    """Mass and inertia of the root body, times `level`."""

    name: ClassVar[str] = "mass"
    needs_simulator: ClassVar[bool] = True


@dataclass(frozen=True)
class Friction(Disturbance):
    """Sliding friction of every geom, times `level`."""

    name: ClassVar[str] = "friction"
    needs_simulator: ClassVar[bool] = True


@dataclass(frozen=True)
class Strength(Disturbance):
    """Gear of every motor, times `level`: the same command gives so much more torque."""

    name: ClassVar[str] = "strength"
    needs_simulator: ClassVar[bool] = True


CALM = "none"
"""Name of no disturbance at all."""
STANDARDS: dict[str, tuple[str, ...]] = {
    "standard-1": (
        "action_noise:0.05",
        "observation_noise:0.02",
        "push:0.25",
        "mass:1.1",
        "friction:0.9",
        "strength:0.9",
    )
}
"""Disturbances that act together under one name, which always means the same ones. Moderate levels: each lies within
what the Real-World RL suite (Dulac-Arnold et al. 2020), RRLS and Robust-Gymnasium vary."""
STANDARD = "standard-1"
"""What an evaluation applies if nothing else is asked for."""
PUSH_STEPS = 200
"""Control steps between two pushes."""
SIMULATED = {
    f"{robot}-{version}": f"gymnasium:{robot}-v4"
    for robot in ("HalfCheetah", "Swimmer", "Hopper", "Walker2d")
    for version in ("v3", "v4")
}
"""EnvPool's tasks to Gymnasium's with the same model and observation. Ant and Humanoid are missing: EnvPool leaves
their contact forces at 0, Gymnasium fills them."""


def parse_disturbance(text: str) -> Disturbance:
    """Return the disturbance of a text such as ``push:0.5``.

    Raises:
        PerdureError: If the text names none, or the level is out of range.
    """
    name, _, level = text.strip().partition(":")
    try:
        number = float(level)
    except ValueError:
        raise PerdureError(
            f"a disturbance is written name:level, for example push:0.5, or one of {', '.join(STANDARDS)}, or {CALM} "
            f"alone; got {text!r}"
        ) from None
    return Disturbance.from_json({"name": name, "level": number})


def parse_disturbances(texts: Sequence[str]) -> tuple[Disturbance, ...]:
    """Return disturbances that act together, in one order; none for "none", and all of a name in `STANDARDS`.

    Raises:
        PerdureError: If a text names none, or a kind is named twice.
    """
    if tuple(texts) == (CALM,):
        return ()
    found = [parse_disturbance(each) for text in texts for each in STANDARDS.get(text, (text,))]
    if len({each.name for each in found}) < len(found):
        raise PerdureError(f"one kind of disturbance is named twice: {', '.join(each.label for each in found)}")
    return tuple(sorted(found, key=lambda each: each.name))


def labels(disturbances: Sequence[Disturbance]) -> str:
    """Return how tables name disturbances that act together: "action_noise:0.1 push:0.5"."""
    return " ".join(each.label for each in disturbances) or CALM


def disturbed_task(task: str, disturbances: Sequence[Disturbance]) -> str:
    """Return the task to simulate: Gymnasium's copy of EnvPool's where a disturbance needs MuJoCo's state.

    Raises:
        PerdureError: If there is no such copy.
    """
    needing = [each.label for each in disturbances if each.needs_simulator]
    if not needing or task.startswith("gymnasium:"):
        return task
    if task not in SIMULATED:
        raise PerdureError(
            f"{', '.join(needing)} needs MuJoCo's own state, which {task} does not give; it works for "
            f"{', '.join(SIMULATED)} and for gymnasium:ID"
        )
    return SIMULATED[task]


class DisturbedWorld:
    """A `World` whose lanes are disturbed; see `World` for its methods."""

    def __init__(
        self,
        world: World,
        disturbances: Sequence[Disturbance],
        seeds: Sequence[int],
        observation_std: FloatArray | None = None,
    ) -> None:
        """Wrap a world that was not reset yet.

        Args:
            world: Its lanes are disturbed.
            disturbances: At most one of each kind.
            seeds: Of the draws, one for each lane.
            observation_std: Spread of each observation component in training, shape (num_lanes, observation_size);
                needed for observation noise.

        Raises:
            PerdureError: A kind is named twice, or cannot be applied to this world.
        """
        self._world, self._seeds = world, list(seeds)
        self._of = {each.name: each for each in disturbances}
        if len(self._of) < len(disturbances):
            raise PerdureError(f"one kind of disturbance is named twice: {', '.join(d.label for d in disturbances)}")
        spec = world.spec
        box = np.isfinite([spec.action_low, spec.action_high]).all() and not spec.discrete_actions
        for name in ("action_noise", "action_delay"):
            if name in self._of and not box:
                raise PerdureError(f"{name} needs actions in a finite box, those of {spec.name} are not")
        if "observation_noise" in self._of and observation_std is None:
            raise PerdureError("observation_noise needs the spread of the observations in training")
        lanes, size = world.num_lanes, spec.observation_size
        self._std = np.zeros((lanes, size)) if observation_std is None else np.asarray(observation_std, np.float64)
        self._half = 0.5 * (spec.action_high - spec.action_low)
        self._neutral = np.clip(np.zeros(spec.action_size), spec.action_low, spec.action_high)
        self._episodes = np.zeros(lanes, np.int64)
        self._noise = {
            name: np.zeros((lanes, BLOCK, width))
            for name, width in (("action_noise", spec.action_size), ("observation_noise", size))
            if name in self._of
        }
        self._queue = np.zeros((lanes, int(self._level("action_delay", 0)), spec.action_size))
        self._simulators = self._open_simulators() if any(each.needs_simulator for each in disturbances) else []

    @property
    def spec(self) -> TaskSpec:
        """See `World.spec`."""
        return self._world.spec

    @property
    def spaces(self) -> tuple[Any, Any]:
        """See `World.spaces`."""
        return self._world.spaces

    @property
    def num_lanes(self) -> int:
        """See `World.num_lanes`."""
        return self._world.num_lanes

    @property
    def elapsed(self) -> IntArray:
        """See `World.elapsed`."""
        return self._world.elapsed

    def reset(self, lanes: IntArray | None = None) -> FloatArray:
        """See `World.reset`."""
        observations = self._world.reset(lanes)
        chosen = np.arange(self.num_lanes) if lanes is None else np.asarray(lanes)
        self._episodes[chosen] += 1
        self._queue[chosen] = self._neutral
        return observations + self._observation_noise(chosen, np.zeros(len(chosen), np.int64))

    def step(self, actions: FloatArray, lanes: IntArray | None = None) -> Step:
        """See `World.step`."""
        chosen = np.arange(self.num_lanes) if lanes is None else np.asarray(lanes)
        elapsed = self._world.elapsed[chosen]
        actions = np.asarray(actions, np.float64)
        if "action_noise" in self._of:
            noise = self._draw("action_noise", chosen, elapsed)
            actions = np.clip(actions, self.spec.action_low, self.spec.action_high)
            actions = actions + self._level("action_noise") * self._half * noise
        if delay := self._queue.shape[1]:
            place = elapsed % delay
            late = self._queue[chosen, place]
            self._queue[chosen, place] = actions
            actions = late
        if "push" in self._of:
            self._push(chosen, elapsed)
        step = self._world.step(actions, lanes)
        if "observation_noise" in self._of:
            noise = self._observation_noise(chosen, elapsed + 1)
            values = (step.rewards, step.terminated, step.truncated, step.elapsed, step.diverged)
            return Step(step.observations + noise, *values)
        return step

    def abandon(self, lanes: IntArray) -> None:
        """See `World.abandon`."""
        self._world.abandon(lanes)

    def close(self) -> None:
        """See `World.close`."""
        self._world.close()

    def _level(self, name: str, default: float = 0.0) -> float:
        return self._of[name].level if name in self._of else default

    def _generator(self, name: str, lane: int, block: int) -> np.random.Generator:
        key = [self._seeds[lane], zlib.crc32(name.encode()), int(self._episodes[lane]), block]
        return np.random.Generator(np.random.Philox(np.random.SeedSequence(key)))

    def _draw(self, name: str, lanes: IntArray, steps: IntArray) -> FloatArray:
        """Return standard normal numbers for these steps of these lanes, shape (n, width)."""
        block, row = self._noise[name], steps % BLOCK
        for lane, step in zip(lanes[row == 0], steps[row == 0], strict=True):
            block[lane] = self._generator(name, lane, int(step) // BLOCK).standard_normal(block.shape[1:])
        drawn: FloatArray = block[lanes, row]
        return drawn

    def _observation_noise(self, lanes: IntArray, steps: IntArray) -> FloatArray:
        if "observation_noise" not in self._of:
            return np.zeros((len(lanes), self.spec.observation_size))
        noise = self._draw("observation_noise", lanes, steps)
        return self._level("observation_noise") * self._std[lanes] * noise

    def _open_simulators(self) -> list[tuple[Any, IntArray]]:
        """Return (data, numbers of the root's horizontal velocities) of each lane; change the models' factors."""
        import mujoco

        name = self.spec.name
        if not isinstance(self._world, GymnasiumWorld):
            raise PerdureError(f"{name}: pushes and factors need an environment of Gymnasium's MuJoCo (gymnasium:ID)")
        found = []
        for env in self._world.environments:
            model, data = getattr(env.unwrapped, "model", None), getattr(env.unwrapped, "data", None)
            if model is None or data is None:
                raise PerdureError(f"{name}: pushes and factors need an environment of Gymnasium's MuJoCo")
            model.body_mass[1] *= self._level("mass", 1.0)
            model.body_inertia[1] *= self._level("mass", 1.0)
            model.geom_friction[:, 0] *= self._level("friction", 1.0)
            model.actuator_gear *= self._level("strength", 1.0)
            if "mass" in self._of:
                mujoco.mj_setConst(model, data)  # quantities that MuJoCo derives from masses
            found.append((data, horizontal_velocities(model)))
        return found

    def _push(self, lanes: IntArray, elapsed: IntArray) -> None:
        for lane, step in zip(lanes, elapsed, strict=True):
            if step and step % PUSH_STEPS == 0:
                data, numbers = self._simulators[lane]
                draw = self._generator("push", lane, int(step)).uniform(-1.0, 1.0, len(numbers))
                data.qvel[numbers] += self._level("push") * draw


def horizontal_velocities(model: Any) -> IntArray:
    """Return the numbers in `qvel` of the root's velocities along x and y.

    Args:
        model: MuJoCo's model; its root is the first body. Planar robots have one such velocity.

    Raises:
        PerdureError: If the root does not move.
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
