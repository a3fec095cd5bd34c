"""What a robot earns that does nothing useful: the lower end of every score.

An alive bonus is paid for standing and for lying on the back. So a policy is measured against the better of two that
need no training: the zero action, and actions drawn uniformly from the action box.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from perdure.envs import World, make_world
from perdure.extrapolate.errors import ExtrapolationError
from perdure.runs import Unit, Work, config_digest, write_whole
from perdure.schema import Real, SchemaError, Table, read_json

EPISODES = 20
"""Episodes of each of the two; also start states."""
STEPS = 1000
"""Steps an episode may last."""
FIRST_SEED = 500_000
"""Episode k starts from world seed FIRST_SEED + k, as the reference episodes of a policy do."""
FILE = "idle.json"
RATES = Table({"zero": Real(), "random": Real()})
"""What the file holds."""
WITHOUT_BOUND = 1.0
"""Random actions stay within +-this where the action box has no bound."""


@dataclass(frozen=True)
class Idle:
    """Mean reward of a step, over all steps of all episodes. A fall ends an episode and costs nothing else."""

    zero: float
    """Under the zero action (clipped to the action box)."""
    random: float
    """Under uniform random actions."""

    @property
    def rate(self) -> float:
        """Reward per step of the better one."""
        return max(self.zero, self.random)

    @property
    def kind(self) -> Literal["zero action", "random actions"]:
        """Which one that is."""
        return "zero action" if self.zero >= self.random else "random actions"


def measure_idle(world: World, steps: int = STEPS) -> Idle:
    """Run both from every start state of a world, one lane each, in this process."""
    rng = np.random.default_rng(0)
    low = np.where(np.isfinite(world.spec.action_low), world.spec.action_low, -WITHOUT_BOUND)
    high = np.where(np.isfinite(world.spec.action_high), world.spec.action_high, WITHOUT_BOUND)
    zero = np.clip(np.zeros_like(low), low, high)
    rates = []
    for scale in (0.0, 1.0):
        earned, made = 0.0, 0
        world.reset()
        lanes: NDArray[np.int64] = np.arange(world.num_lanes)
        for _ in range(steps):
            actions = zero + scale * (rng.uniform(low, high, (len(lanes), len(low))) - zero)
            step = world.step(actions, lanes)
            valid = np.isfinite(step.rewards) & ~step.diverged
            earned, made = earned + float(step.rewards[valid].sum()), made + int(valid.sum())
            lanes = lanes[valid & ~step.ended]
            if not len(lanes):
                break
        if not made:
            raise ExtrapolationError(f"{world.spec.name}: no reward of an idle robot could be measured")
        rates.append(earned / made)
    return Idle(*rates)


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
    """Measure a task and leave the result in the work folder; the function of `idle_unit`."""
    world = make_world(task, [FIRST_SEED + k for k in range(EPISODES)])
    try:
        idle = measure_idle(world)
    finally:
        world.close()
    write_whole(work.folder / FILE, json.dumps(asdict(idle)) + "\n")


def read_idle(folder: Path) -> Idle:
    """Return what `run_idle` left; ExtrapolationError if its file is damaged."""
    try:
        values = read_json((folder / FILE).read_bytes())
        RATES.check(values)
    except SchemaError as error:
        raise ExtrapolationError(f"{folder / FILE} cannot be read: {error}; remove {folder}") from error
    return Idle(**values)
