"""Reward rate of an idle robot (zero or random actions): the zero of every score.

A robot may earn an alive bonus while it does nothing useful. The idle rate is therefore the larger rate of two
untrained policies: the zero action, and actions drawn uniformly from the action box.

Discrete actions have no zero action. The best constant action replaces it: each of up to MOST_CONSTANT actions is
repeated for whole episodes.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from perdure.envs import TaskSpec, World, make_world
from perdure.extrapolate.errors import ExtrapolationError
from perdure.policy import LaneStep
from perdure.policy.divergence import DivergenceDetector
from perdure.runs import Unit, Work, config_digest, write_atomic
from perdure.schema import Flag, Real, SchemaError, Table, read_json

EPISODES = 20
"""Episodes of each of the two policies; as many start states."""
STEPS = 1000
"""Most steps of an episode."""
FIRST_SEED = 500_000
"""Episode k starts from world seed FIRST_SEED + k, as the reference episodes of a policy do."""
FILE = "idle.json"
MOST_CONSTANT = 16
"""Constant discrete actions that are tried: all, or as many of them evenly spread."""
RATES = Table({"zero": Real(), "random": Real()}, optional={"discrete": Flag()})
"""Contents of the file."""
WITHOUT_BOUND = 1.0
"""Random actions stay within +-this where the action box has no bound, or is too wide to draw from. Where the other
bound lies outside, they stay this close to it."""


@dataclass(frozen=True)
class Idle:
    """Mean reward of a step, over all steps of all episodes. A fall ends an episode and costs nothing else."""

    zero: float
    """Under the zero action (clipped to the action box), or under the best constant discrete action."""
    random: float
    """Under uniform random actions."""
    discrete: bool = False
    """Whether actions are discrete."""

    @property
    def rate(self) -> float:
        """Reward per step of the better one."""
        return max(self.zero, self.random)

    @property
    def kind(self) -> Literal["zero action", "best constant action", "random actions"]:
        """Which one that is."""
        if self.zero < self.random:
            return "random actions"
        return "best constant action" if self.discrete else "zero action"


def measure_idle(world: World | Sequence[World], steps: int = STEPS) -> Idle:
    """Run both from every start state of a world, one lane each, in this process.

    Args:
        world: Where; several worlds of one task count as one with all their lanes.
        steps: Steps an episode may last.
    """
    worlds = world if isinstance(world, Sequence) else [world]
    spec = worlds[0].spec
    actions = _idle_actions(spec, np.random.default_rng(0))
    total = np.sum([[_earned(each, choose, steps) for choose in actions] for each in worlds], axis=0)
    if not total[:, 1].all():
        raise ExtrapolationError(f"{spec.name}: no reward of an idle robot could be measured")
    *constant, random = (total[:, 0] / total[:, 1]).tolist()
    return Idle(max(constant), random, spec.discrete_actions)


Choose = Callable[[int], NDArray[np.float64]]
"""Number of lanes -> an action for each."""


def _idle_actions(spec: TaskSpec, rng: np.random.Generator) -> list[Choose]:
    """Return constant actions, and finally random ones."""
    if spec.discrete_actions:
        least, most = spec.action_low.astype(np.int64), spec.action_high.astype(np.int64)
        held: list[Choose] = [lambda n, row=row: np.tile(row, (n, 1)) for row in constant_actions(spec)]  # type: ignore[misc]
        return [*held, lambda n: rng.integers(least, most + 1, (n, len(least))).astype(np.float64)]
    low, high = spec.action_low, spec.action_high
    with np.errstate(over="ignore"):
        too_wide = np.isfinite(low) & np.isfinite(high) & ~np.isfinite(high - low)
    open_low, open_high = too_wide | ~np.isfinite(low), too_wide | ~np.isfinite(high)
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
    earned, made = 0.0, 0
    before = world.reset()
    detector = DivergenceDetector(before, np.zeros_like(before), world.spec.hides_divergence)
    lanes: NDArray[np.int64] = np.arange(world.num_lanes)
    for _ in range(steps):
        step = world.step(choose(len(lanes)), lanes)
        valid = ~detector.diverged(LaneStep(lanes, before, step))
        earned, made = earned + float(step.rewards[valid].sum()), made + int(valid.sum())
        stays = valid & ~step.ended
        if not stays.all():
            world.abandon(lanes[~stays])
        lanes, before = lanes[stays], step.observations[stays]
        if not len(lanes):
            break
    return earned, made


def idle_unit(task: str, versions: dict[str, str]) -> Unit:
    """Return the measurement as a unit of work."""
    config = {"task": task, "episodes": EPISODES, "steps": STEPS, "versions": versions}
    return Unit(
        f"idle/{config_digest(config)[:16]}",
        config,
        "perdure.extrapolate.idle:run_idle",
        {"task": task},
        size=float(2 * EPISODES * STEPS),
    )


def run_idle(work: Work, *, task: str) -> None:
    """Measure the idle rate of a task and write it to the work folder; the function of `idle_unit`."""
    world = make_world(task, [FIRST_SEED + k for k in range(EPISODES)])
    try:
        idle = measure_idle(world)
    finally:
        world.close()
    write_atomic(work.folder / FILE, json.dumps(asdict(idle)) + "\n")


def read_idle(folder: Path) -> Idle:
    """Return what `run_idle` left; ExtrapolationError if its file is damaged."""
    try:
        values = read_json((folder / FILE).read_bytes())
        RATES.check(values)
    except SchemaError as error:
        raise ExtrapolationError(f"{folder / FILE} cannot be read: {error}; remove {folder}") from error
    return Idle(**values)
