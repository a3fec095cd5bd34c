"""Reward rates that scores are relative to: of the policy within its training horizon, and of an idle robot.

Idle is a robot that takes zero or random actions: the zero of every score. It may earn an alive bonus while it does
nothing useful. The idle rate is therefore the larger rate of two untrained policies: the zero action, and actions drawn
uniformly from the action box.

Discrete actions have no zero action. The best constant action replaces it: each of up to MOST_CONSTANT actions is
repeated for whole episodes.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields, replace
from fractions import Fraction
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from perdure.envs import OpenEnv, TaskSpec, World, make_world, report_success
from perdure.errors import PerdureError
from perdure.policy import (
    DivergenceDetector,
    FunctionPolicy,
    LoopStep,
    Policy,
    PolicyLike,
    Reference,
    measure_reference,
)
from perdure.policy.reference import EPISODES, FIRST_SEED
from perdure.runs import Unit, Work, config_digest, write_atomic
from perdure.schema import Number, read_json

STEPS = 1000
"""Most steps of an episode."""
FILE = "idle.json"
REFERENCE = "reference.safetensors"
MOST_CONSTANT = 16
"""Constant discrete actions that are tried: all, or as many of them evenly spread."""
WITHOUT_BOUND = 1.0
"""Random actions stay within +-this where the action box has no bound, or is too wide to draw from. Where the other
bound lies outside, they stay this close to it."""


@dataclass(frozen=True)
class Idle:
    """Mean reward of a step, over all steps of all episodes. A fall ends an episode and costs nothing else."""

    zero: Number
    """Under the zero action (clipped to the action box), or under the best constant discrete action."""
    random: Number
    """Under uniform random actions."""
    discrete: bool = False
    """Whether actions are discrete."""
    zero_steps: Number | None = None
    """Mean steps that an episode of the first one lasts, of `STEPS` at most; None: not measured."""
    random_steps: Number | None = None
    """Likewise of the second one."""

    @property
    def rate(self) -> float:
        """Reward per step of the better one."""
        return max(self.zero, self.random)

    @property
    def steps(self) -> float:
        """Mean steps that an episode of the better one lasts; nan where it was not measured."""
        found = self.random_steps if self.zero < self.random else self.zero_steps
        return math.nan if found is None else found

    @property
    def kind(self) -> Literal["zero action", "best constant action", "random actions"]:
        """Which one that is."""
        if self.zero < self.random:
            return "random actions"
        return "best constant action" if self.discrete else "zero action"


def measure_idle(world: World | Sequence[World], steps: int = STEPS) -> Idle:
    """Run both from every start state of a world, one episode each, in this process.

    Args:
        world: Where; several worlds of one task count as one with all their episodes.
        steps: Steps an episode may last.
    """
    worlds = world if isinstance(world, Sequence) else [world]
    spec = worlds[0].spec
    actions = _idle_actions(spec, np.random.default_rng(0))
    total = np.sum([[_earned(each, choose, steps) for choose in actions] for each in worlds], axis=0)
    if not total[:, 1].all():
        raise PerdureError(f"{spec.name}: no reward of an idle robot could be measured")
    *constant, random = (total[:, 0] / total[:, 1]).tolist()
    episodes = sum(each.num_lanes for each in worlds)
    *constant_steps, random_steps = (total[:, 1] / episodes).tolist()
    best = int(np.argmax(constant))
    return Idle(constant[best], random, spec.discrete_actions, constant_steps[best], random_steps)


Choose = Callable[[int], NDArray[np.float64]]
"""Number of episodes -> an action for each."""


def _idle_actions(spec: TaskSpec, rng: np.random.Generator) -> list[Choose]:
    """Return constant actions, and finally random ones."""
    if spec.discrete_actions:
        least = spec.action_low.astype(np.int64)
        most = spec.action_high.astype(np.int64)
        held: list[Choose] = [lambda n, row=row: np.tile(row, (n, 1)) for row in constant_actions(spec)]  # type: ignore[misc]
        return [*held, lambda n: rng.integers(least, most + 1, (n, len(least))).astype(np.float64)]
    low = spec.action_low
    high = spec.action_high
    with np.errstate(over="ignore"):
        too_wide = np.isfinite(low) & np.isfinite(high) & ~np.isfinite(high - low)
    open_low = too_wide | ~np.isfinite(low)
    open_high = too_wide | ~np.isfinite(high)
    low_box = np.where(open_low, np.where(open_high | (high > -WITHOUT_BOUND), 0.0, high) - WITHOUT_BOUND, low)
    high_box = np.where(open_high, np.where(open_low | (low < WITHOUT_BOUND), 0.0, low) + WITHOUT_BOUND, high)
    zero = np.clip(np.zeros_like(low_box), low_box, high_box)

    def between(scale: float) -> Choose:
        return lambda n: zero + scale * (rng.uniform(low_box, high_box, (n, len(zero))) - zero)

    return [between(0.0), between(1.0)]


def constant_actions(spec: TaskSpec) -> NDArray[np.float64]:
    """Return the discrete actions that an idle robot holds, shape (at most MOST_CONSTANT, action_size)."""
    sizes = [int(size) for size in spec.action_high - spec.action_low + 1]
    total = math.prod(sizes)
    last = min(total, MOST_CONSTANT) - 1
    chosen = [round(Fraction(k * (total - 1), max(last, 1))) for k in range(last + 1)]
    rows = []
    for number in chosen:
        row = []
        for size in reversed(sizes):
            number, digit = divmod(number, size)
            row.append(digit)
        rows.append(row[::-1])
    return np.array(rows, np.float64) + spec.action_low


def _earned(world: World, choose: Choose, steps: int) -> tuple[float, float]:
    """Return the sum of rewards and the number of steps."""
    earned = 0.0
    made = 0
    before = world.reset()
    detector = DivergenceDetector(before, np.zeros_like(before), world.spec.hides_divergence)
    episodes: NDArray[np.int64] = np.arange(world.num_lanes)
    for _ in range(steps):
        step = world.step(choose(len(episodes)), episodes)
        valid = ~detector.diverged(LoopStep(episodes, before, step))
        earned += float(step.rewards[valid].sum())
        made += int(valid.sum())
        stays = valid & ~step.ended
        if not stays.all():
            world.abandon(episodes[~stays])
        episodes = episodes[stays]
        before = step.observations[stays]
        if not len(episodes):
            break
    return earned, made


def idle_unit(task: str, versions: dict[str, str], source: OpenEnv | None = None) -> Unit:
    """Return the measurement as a unit of work; `source` builds an environment that is no task by its name."""
    config = {"task": task, "episodes": EPISODES, "steps": STEPS, "versions": versions}
    return Unit(
        f"idle/{config_digest(config)[:16]}",
        config,
        f"{__name__}:run_idle",
        {"task": task, "source": source},
        size=float(2 * EPISODES * STEPS),
    )


def run_idle(work: Work, *, task: str, source: OpenEnv | None) -> None:
    """Measure the idle rate of a task and write it to the work folder; the function of `idle_unit`."""
    write_atomic(work.folder / FILE, json.dumps(asdict(idle_baseline(source or task_env(task)))) + "\n")


def read_idle(folder: Path) -> Idle:
    """Return what `run_idle` left; PerdureError if its file is damaged."""
    try:
        idle: Idle = read_json((folder / FILE).read_bytes(), Idle)
    except PerdureError as error:
        raise PerdureError(f"{folder / FILE} cannot be read: {error}; remove {folder}") from error
    return idle


def idle_baseline(source: OpenEnv) -> Idle:
    """Return what an idle robot earns, from EPISODES start states or the next number that fills a VectorEnv."""
    worlds = list(_worlds(source))
    try:
        return measure_idle(worlds)
    finally:
        for world in worlds:
            world.close()


def with_reference(policy: PolicyLike, source: OpenEnv) -> PolicyLike:
    """Return the policy with its reference episodes, and a function with the spread of its observations.

    A `Policy` that holds reference episodes already is returned as it is.
    """
    if isinstance(policy, Policy) and policy.reference is not None:
        return policy
    running_std = _RunningStd(policy.task.observation_size)
    parts = [measure_reference(policy, world.num_lanes, world, running_std.update) for world in _worlds(source)]
    return _measured(policy, _joined(parts), running_std.std)


def _worlds(source: OpenEnv) -> Iterator[World]:
    size = source.lanes or EPISODES
    for group in source.groups(-(-EPISODES // size) * size):
        yield source.make([FIRST_SEED + k for k in group])


def _joined(parts: Sequence[Reference]) -> Reference:
    return Reference(
        parts[0].horizon,
        np.concatenate([part.rewards for part in parts]),
        np.concatenate([part.lengths for part in parts]),
        np.concatenate([part.terminated for part in parts]),
        np.min([part.observation_low for part in parts], axis=0),
        np.max([part.observation_high for part in parts], axis=0),
    )


class _RunningStd:
    """Standard deviation of observations; sums are kept around the first of them, against cancellation."""

    def __init__(self, size: int) -> None:
        self._shift: NDArray[np.float64] | None = None
        self._count = 0
        self._sum = np.zeros(size)
        self._squares = np.zeros(size)

    def update(self, loop_step: LoopStep) -> None:
        rows = loop_step.before
        if self._shift is None:
            self._shift = rows[0].copy()
        centered = rows - self._shift
        self._count += len(rows)
        self._sum += centered.sum(axis=0)
        self._squares += (centered**2).sum(axis=0)

    @property
    def std(self) -> NDArray[np.float64]:
        mean = self._sum / self._count
        result: NDArray[np.float64] = np.sqrt(np.maximum(self._squares / self._count - mean**2, 0.0))
        return result


def task_env(task: str, success: str | None = None) -> OpenEnv:
    """Return a builder of worlds of a task by its name; `success`: see `report_success`."""
    return OpenEnv(lambda seeds: report_success(make_world(task, seeds), success))


def save_reference(policy: PolicyLike, folder: Path) -> None:
    """Write the reference episodes of a policy, and the spread of its observations, into a folder."""
    from safetensors.numpy import save

    assert policy.reference is not None
    arrays = {each.name: np.asarray(getattr(policy.reference, each.name)) for each in fields(Reference)}
    write_atomic(folder / REFERENCE, save({**arrays, "std": np.asarray(policy.observation_std)}))


def load_reference(policy: PolicyLike, folder: Path) -> PolicyLike:
    """Return the policy with what `save_reference` wrote; PerdureError if the file is damaged."""
    from safetensors import SafetensorError
    from safetensors.numpy import load

    try:
        arrays = load((folder / REFERENCE).read_bytes())
        std = arrays.pop("std")
        reference = Reference(**{**arrays, "horizon": int(arrays["horizon"])})  # type: ignore[arg-type]
    except (SafetensorError, KeyError, TypeError, ValueError) as error:
        raise PerdureError(f"{folder / REFERENCE} cannot be read: {error}; remove {folder}") from error
    return _measured(policy, reference, std)


def _measured(policy: PolicyLike, reference: Reference, std: NDArray[np.float64]) -> PolicyLike:
    if isinstance(policy, Policy):
        return replace(policy, reference=reference)
    assert isinstance(policy, FunctionPolicy)
    return replace(policy, reference=reference, std=std)
