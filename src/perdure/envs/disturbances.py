"""Disturbed worlds: `DisturbedWorld` adds `perdure.disturbances` to any world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module

import numpy as np

from perdure.disturbances import Disturbance, Disturber
from perdure.envs.suites import is_contract
from perdure.envs.world import FloatArray, IntArray, Step, World, checked_lanes
from perdure.errors import PerdureError

SIMULATED = {
    "HalfCheetah-v3": "gymnasium:HalfCheetah-v4",
    "HalfCheetah-v4": "gymnasium:HalfCheetah-v4",
    "Swimmer-v3": "gymnasium:Swimmer-v4",
    "Swimmer-v4": "gymnasium:Swimmer-v4",
    "Hopper-v3": "gymnasium:Hopper-v4",
    "Hopper-v4": "gymnasium:Hopper-v4",
    "Walker2d-v3": "gymnasium:Walker2d-v4",
    "Walker2d-v4": "gymnasium:Walker2d-v4",
    "Ant-v3": "gymnasium:perdure/Ant-v3",
    "Ant-v4": "gymnasium:Ant-v4",
    "Humanoid-v3": "gymnasium:perdure/Humanoid-v3",
    "Humanoid-v4": "gymnasium:perdure/Humanoid-v3",
}
"""EnvPool's tasks to the environments of Gymnasium that make the same steps; those of perdure are in `copies.py`."""


def disturbed_task(task: str, disturbances: Sequence[Disturbance]) -> str:
    """Return the task to simulate: Gymnasium's copy of EnvPool's where MuJoCo's state is needed, else PerdureError."""
    needing = [each.label for each in disturbances if each.kind.needs_simulator()]
    if not needing or task.startswith("gymnasium:") or is_contract(task):
        return task
    if task not in SIMULATED:
        raise PerdureError(
            f"{', '.join(needing)} needs MuJoCo's own state, which {task} does not give; it works for "
            f"{', '.join(SIMULATED)} and for gymnasium:ID"
        )
    import_module("perdure.envs.copies")  # registers them
    return SIMULATED[task]


class DisturbedWorld:
    """A `World`, not reset before, whose lanes are disturbed; PerdureError if they cannot be. Methods: see `World`."""

    def __init__(
        self,
        world: World,
        disturbances: Sequence[Disturbance],
        seeds: Sequence[int],
        observation_std: FloatArray | None = None,
    ) -> None:
        self._world = world
        self.infos = getattr(world, "infos", ())
        self.spec = world.spec
        self.spaces = world.spaces
        self.num_lanes = world.num_lanes
        self.abandon = world.abandon
        self.close = world.close
        box = None
        if not self.spec.discrete_actions:
            box = (self.spec.action_low, self.spec.action_high)
        environments = getattr(world, "environments", ())
        self._disturber = Disturber(self.spec.name, disturbances, seeds, box, observation_std, environments)
        self._everyone = np.arange(world.num_lanes)

    @property
    def elapsed(self) -> IntArray:
        """See `World.elapsed`."""
        return self._world.elapsed

    @property
    def observation_std(self) -> FloatArray:
        """Spread of each observation component, shape (num_lanes, observation_size); a learner updates it in place."""
        return self._disturber.robots.observation_std

    def reset(self, lanes: IntArray | None = None) -> FloatArray:
        """See `World.reset`."""
        chosen = self._everyone
        if lanes is not None:
            chosen = checked_lanes(lanes, self.num_lanes)
        self._disturber.begin(chosen)  # models are put back before the robot stands in its start state
        observations = self._world.reset(lanes)
        return self._disturber.observe(observations, chosen, np.zeros(len(chosen), np.int64))

    def step(self, actions: FloatArray, lanes: IntArray | None = None) -> Step:
        """See `World.step`."""
        chosen = self._everyone
        if lanes is not None:
            chosen = np.asarray(lanes)
        elapsed = self._world.elapsed[chosen]
        step = self._world.step(self._disturber.act(np.asarray(actions, np.float64), chosen, elapsed), lanes)
        return replace(step, observations=self._disturber.observe(step.observations, chosen, step.elapsed))
