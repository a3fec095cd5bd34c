"""Measure what scores are relative to: the policy and an idle robot within the training horizon."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from perdure.envs import OpenEnv, World
from perdure.extrapolate.idle import EPISODES, FIRST_SEED, Idle, measure_idle
from perdure.policy import FunctionPolicy, LaneStep, Policy, PolicyLike, Reference, measure_reference


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
    reference = _joined(parts)
    if isinstance(policy, Policy):
        return replace(policy, reference=reference)
    assert isinstance(policy, FunctionPolicy)
    return replace(policy, reference=reference, std=running_std.std)


def _worlds(source: OpenEnv) -> Iterator[World]:
    size = source.lanes or EPISODES
    count = -(-EPISODES // size) * size
    return source.worlds([FIRST_SEED + k for k in range(count)])


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
        self._count, self._sum, self._squares = 0, np.zeros(size), np.zeros(size)

    def update(self, lane_step: LaneStep) -> None:
        rows = lane_step.before
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
