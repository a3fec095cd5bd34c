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
from perdure.horizon import Clock
from perdure.policy.errors import PolicyError
from perdure.policy.policy_like import ActingLanes, PolicyLike


@dataclass(frozen=True, eq=False)
class LanePolicy:
    """A policy and the clock that sets its time-to-go input; the clock is None for a policy without that input."""

    policy: PolicyLike
    clock: Clock | None


@dataclass(frozen=True, eq=False)
class LaneStep:
    """One step of the running lanes; row i belongs to lane ``lanes[i]``."""

    lanes: IntArray
    """Lanes that were stepped, shape (n,)."""
    before: FloatArray
    """Observations acted on, shape (n, observation_size)."""
    step: Step
    """Result of the step."""


class ClosedLoop:
    """Step all running lanes until they end; ended lanes leave the batch.

    Raises:
        PolicyError: If the numbers of policies and lanes differ, a policy does not fit the world or its clock, or an
            episode starts with an observation that is not finite.
    """

    def __init__(self, world: World, lane_policies: Sequence[LanePolicy]) -> None:
        """Reset every lane of the world, with no horizon.

        Args:
            world: Has one lane for each lane_policy.
            lane_policies: The policy of lane 0, 1, ...
        """
        if len(lane_policies) != world.num_lanes:
            raise PolicyError(f"{len(lane_policies)} policies for {world.num_lanes} lanes; each lane needs one")
        for lane_policy in lane_policies:
            if (lane_policy.clock is not None) != lane_policy.policy.has_clock:
                raise PolicyError(
                    f"a lane of {lane_policy.policy.task.name} needs a clock exactly if its policy has a time-to-go "
                    f"input; this one has {'no clock' if lane_policy.clock is None else lane_policy.clock.label}"
                )
        for policy in {id(lane_policy.policy): lane_policy.policy for lane_policy in lane_policies}.values():
            check_fit(policy, world)
        self.world = world
        self._observations = world.reset()
        if not np.isfinite(self._observations).all():
            lane, component = np.argwhere(~np.isfinite(self._observations))[0]
            raise PolicyError(
                f"{world.spec.name} starts an episode with observation[{component}] = "
                f"{self._observations[lane, component]}; observations must be finite"
            )
        self._elapsed = 0
        self._running: IntArray = np.arange(world.num_lanes)
        self._groups = _group(lane_policies)

    @property
    def running(self) -> IntArray:
        """Lanes that the next step will move, shape (n,)."""
        return self._running

    @property
    def observations(self) -> FloatArray:
        """Current observations of the running lanes, shape (n, observation_size)."""
        return self._observations

    def advance(self) -> LaneStep:
        """Move every running lane by one step; lanes that end in it are not running afterwards."""
        before = self._observations
        actions = self._act(before)
        step = self.world.step(actions, self._running)
        lane_step = LaneStep(self._running, before, step)
        self._observations = step.observations
        self._elapsed += 1
        if step.ended.any():
            self.drop(self._running[step.ended])
        return lane_step

    def drop(self, lanes: NDArray[np.int64]) -> None:
        """Remove lanes; the other lanes are unaffected."""
        stays = ~np.isin(self._running, lanes)
        if stays.all():
            return
        self.world.abandon(self._running[~stays])
        self._observations = self._observations[stays]
        self._running = self._running[stays]
        place = np.cumsum(stays) - 1
        for group in self._groups:
            kept = stays[group.rows]
            if not kept.all():
                group.acting.keep(kept)
            group.rows = place[group.rows[kept]]
        self._groups = [group for group in self._groups if len(group.rows)]

    def _act(self, observations: FloatArray) -> FloatArray:
        if len(self._groups) == 1:
            return self._groups[0].acting.act(observations, self._elapsed)
        actions = np.empty((len(observations), self.world.spec.action_size))
        for group in self._groups:
            actions[group.rows] = group.acting.act(observations[group.rows], self._elapsed)
        return actions


@dataclass(eq=False)
class _Group:
    """The running lanes of one actor."""

    acting: ActingLanes
    rows: IntArray
    """Their places among all running lanes, rising."""


def _group(lane_policies: Sequence[LanePolicy]) -> list[_Group]:
    by_actor: dict[int, list[int]] = {}
    for row, lane_policy in enumerate(lane_policies):
        by_actor.setdefault(id(lane_policy.policy), []).append(row)
    return [
        _Group(lane_policies[rows[0]].policy.start([lane_policies[row].clock for row in rows]), np.array(rows))
        for rows in by_actor.values()
    ]


def check_fit(policy: PolicyLike, world: World) -> None:
    """Refuse a policy for another task.

    Raises:
        PolicyError: If observation or action sizes, or the action range, differ.
    """
    spec, task = world.spec, policy.task
    same_range = np.array_equal(task.action_low, spec.action_low) and np.array_equal(task.action_high, spec.action_high)
    if task.discrete_actions != spec.discrete_actions:
        kinds = [("discrete" if each else "continuous") for each in (task.discrete_actions, spec.discrete_actions)]
        raise PolicyError(f"a policy for {task.name} has {kinds[0]} actions, those of {spec.name} are {kinds[1]}")
    if task.observation_size != spec.observation_size or not same_range:
        raise PolicyError(
            f"a policy for {task.name} (observations of {task.observation_size}, actions of {task.action_size}) cannot "
            f"act in {spec.name} (observations of {spec.observation_size}, actions of {spec.action_size})"
        )
