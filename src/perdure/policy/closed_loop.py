"""Closed loop over lanes: policies act in a world, step by step, until every lane has ended.

A lane's trajectory depends on its policy, its clock and its seed alone. Neither its neighbors nor the order of the
lanes change one bit of it, because acting is row-invariant and worlds step lanes independently.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perdure.envs import FloatArray, IntArray, Step, World
from perdure.horizon import Clock, Constant, LaneClocks
from perdure.policy.errors import PolicyError
from perdure.policy.policy import Policy


@dataclass(frozen=True, eq=False)
class LanePolicy:
    """A policy and the clock that sets its time-to-go input; the clock is None for a policy without that input."""

    policy: Policy
    clock: Clock | None


@dataclass(frozen=True, eq=False)
class LaneStep:
    """One step of the running lanes; row i belongs to lane ``lanes[i]``."""

    lanes: IntArray
    """Lanes that were stepped, shape (n,)."""
    before: FloatArray
    """Observations acted on, shape (n, observation_size)."""
    step: Step
    """What the world answered."""


class ClosedLoop:
    """Carries lanes on until they end. Lanes that have ended cost nothing.

    Raises:
        PolicyError: If there is not one lane_policy for each lane, or a policy fits neither the world nor its clock.
    """

    def __init__(self, world: World, lane_policies: Sequence[LanePolicy]) -> None:
        """Resets every lane of the world, with no horizon.

        Args:
            world: Where to act; one lane for each lane_policy.
            lane_policies: Who acts in lane 0, 1, ...
        """
        if len(lane_policies) != world.num_lanes:
            raise PolicyError(f"{len(lane_policies)} policies for {world.num_lanes} lanes; each lane needs one")
        for lane_policy in lane_policies:
            if (lane_policy.clock is None) != (lane_policy.policy.protocol.embedding is None):
                raise PolicyError(
                    f"a lane of {lane_policy.policy.task.name} needs a clock exactly if its policy has an embedding; "
                    f"this one has {'no clock' if lane_policy.clock is None else lane_policy.clock.label}"
                )
        for policy in {id(lane_policy.policy): lane_policy.policy for lane_policy in lane_policies}.values():
            check_fit(policy, world)
        self.world = world
        self._lane_policies = list(lane_policies)
        self._observations = world.reset()
        self._elapsed = 0
        self._live(np.arange(world.num_lanes))

    @property
    def living(self) -> IntArray:
        """Lanes that the next step will move, shape (n,)."""
        return self._living

    @property
    def observations(self) -> FloatArray:
        """What the living lanes see now, shape (n, observation_size)."""
        return self._observations

    def advance(self) -> LaneStep:
        """Moves every living lane by one step. Lanes that ended with it are not living afterwards."""
        before = self._observations
        actions = self._act(before)
        step = self.world.step(actions, self._living)
        lane_step = LaneStep(self._living, before, step)
        self._observations = step.observations
        self._elapsed += 1
        if step.ended.any():
            self.drop(self._living[step.ended])
        return lane_step

    def drop(self, lanes: NDArray[np.int64]) -> None:
        """Takes lanes out; the others go on as if these had never been there."""
        stays = ~np.isin(self._living, lanes)
        self._observations = self._observations[stays]
        self._live(self._living[stays])

    def _act(self, observations: FloatArray) -> FloatArray:
        if len(self._by_policy) == 1:
            return self._by_policy[0].act(observations, self._elapsed)
        actions = np.empty((len(observations), self.world.spec.action_size))
        for group in self._by_policy:
            actions[group.rows] = group.act(observations[group.rows], self._elapsed)
        return actions

    def _live(self, living: IntArray) -> None:
        self._living = living
        by_policy: dict[int, list[int]] = {}
        for row, lane in enumerate(living):
            by_policy.setdefault(id(self._lane_policies[lane].policy), []).append(row)
        self._by_policy = [
            _PolicyRows(rows, [self._lane_policies[living[row]] for row in rows]) for rows in by_policy.values()
        ]


class _PolicyRows:
    """The living lanes of one policy."""

    def __init__(self, rows: list[int], lane_policies: list[LanePolicy]) -> None:
        self.rows = np.array(rows)
        self._policy = lane_policies[0].policy
        clocks = [lane_policy.clock for lane_policy in lane_policies if lane_policy.clock is not None]
        self._clocks = LaneClocks(clocks) if clocks else None
        # Clocks that stand still, and policies without phi, are told the same at every step.
        still = all(isinstance(clock, Constant) for clock in clocks)
        self._phi = self._embed(0) if still else None

    def act(self, observations: FloatArray, elapsed: int) -> FloatArray:
        return self._policy.act_with(observations, self._embed(elapsed) if self._phi is None else self._phi)

    def _embed(self, elapsed: int) -> FloatArray:
        steps = np.full(len(self.rows), float(elapsed))
        times, horizons = (steps, steps) if self._clocks is None else self._clocks.time(steps)
        return self._policy.embed(times, horizons)


def check_fit(policy: Policy, world: World) -> None:
    """Refuses a policy for another task.

    Raises:
        PolicyError: If observation or action sizes, or the action box, differ.
    """
    spec, task = world.spec, policy.task
    same_box = np.array_equal(task.action_low, spec.action_low) and np.array_equal(task.action_high, spec.action_high)
    if task.observation_size != spec.observation_size or not same_box:
        raise PolicyError(
            f"a policy for {task.name} (observations of {task.observation_size}, actions of {task.action_size}) cannot "
            f"act in {spec.name} (observations of {spec.observation_size}, actions of {spec.action_size})"
        )
