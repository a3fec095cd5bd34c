"""Checkpoints within a segment: the learner, the running episodes, and the actions that lead new environments there.

An engine's state cannot be saved, but it follows from the environments' seeds and the actions. So a run that resumes
within a segment builds the segment's environments again and sends them the recorded actions, without learning.
Results do not depend on whether and when such a checkpoint was written.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perdure.envs.disturbances import DisturbedWorld
from perdure.envs.world import World
from perdure.errors import PerdureError
from perdure.learn.algorithm import Sent
from perdure.learn.checkpoint import RunState, checkpoint_place, load_checkpoint, save_checkpoint

SECONDS = 2.0
"""Least time between two checkpoints of a segment; the first one follows its first iteration."""
LARGEST_SHARE = 0.01
"""Of training time that writing may take: large files are written less often."""


class ReplayError(PerdureError):
    """The recorded actions do not lead to the recorded observations."""


@dataclass(frozen=True)
class PartialState(RunState):
    """One seed's run in the middle of its next segment."""

    iteration: int
    """Iterations finished, of the whole run."""
    running: Any
    """The algorithm's running environments, see `Algorithm.start`."""
    sent: Sent
    """Of all iterations of the segment so far."""
    observation_std: NDArray[np.float64]
    """What scaled the observation noise of each of these iterations, shape (iterations, observation_size); no rows
    where nothing is disturbed."""


class Recorder:
    """Records what one segment's environments are sent, writes partial checkpoints, and resumes from one.

    Args:
        path: File of the partial checkpoint; None: there is none.
        world: The segment's environments, reset once.
    """

    def __init__(self, path: Path | None, world: World) -> None:
        self._path = path
        self._world = world
        lanes = world.num_lanes
        spec = world.spec
        actions = np.zeros((0, lanes, spec.action_size), np.float32)
        self._sent = [Sent(actions, np.zeros((0, lanes), np.bool_), np.zeros((lanes, spec.observation_size)))]
        self._stds = [np.zeros((0, spec.observation_size))]
        self._due = time.monotonic()

    def resume(self, state: RunState, running: Any, iteration: int) -> PartialState:
        """Return where the segment stands, with the environments there: at its beginning, or where its file says.

        Args:
            state: At the beginning of the segment, after `Algorithm.start`.
            running: From `Algorithm.start`.
            iteration: Iterations before the segment.

        Raises:
            ReplayError: The environments are not where they were. The file is removed; the world is of no use.
            PerdureError: The file is damaged or of another run.
        """
        begun = self._state(state, running, iteration)
        if self._path is None:
            return begun
        segment, reached = checkpoint_place(self._path)
        if segment != state.segment or reached <= iteration:  # there is none, or it should have been removed
            return begun
        found = load_checkpoint(self._path, begun)
        try:
            self._replay(found, reached - iteration)
        except PerdureError as error:
            self._path.unlink()
            raise ReplayError(f"{self._world.spec.name} does not repeat its steps ({error})") from error
        self._sent = [found.sent]
        self._stds = [found.observation_std]
        return found

    def keep(self, state: RunState, running: Any, iteration: int, sent: Sent | None) -> None:
        """Record an iteration, and write where the run stands after it if it is time to.

        Args:
            state: After the iteration.
            running: After the iteration.
            iteration: Iterations so far.
            sent: In this iteration; None: the algorithm does not tell, so nothing is kept.
        """
        if self._path is None or sent is None:
            return
        self._sent.append(sent)
        if isinstance(self._world, DisturbedWorld):
            self._stds.append(self._world.observation_std[:1].copy())  # the same in all lanes
        began = time.monotonic()
        if began >= self._due:
            save_checkpoint(self._state(state, running, iteration), self._path)
            now = time.monotonic()
            self._due = now + max(SECONDS, (now - began) / LARGEST_SHARE)

    def _state(self, state: RunState, running: Any, iteration: int) -> PartialState:
        actions, done, _ = zip(*self._sent, strict=True)
        sent = Sent(np.concatenate(actions), np.concatenate(done), self._sent[-1].observations)
        return PartialState(
            **vars(state), iteration=iteration, running=running, sent=sent, observation_std=np.concatenate(self._stds)
        )

    def _replay(self, found: PartialState, iterations: int) -> None:
        """Send the environments what they were sent in so many iterations of equal length."""
        world = self._world
        observations = np.empty(0)
        actions, done = (np.split(each, iterations) for each in found.sent[:2])
        for number in range(iterations):
            if isinstance(world, DisturbedWorld):
                world.observation_std[:] = found.observation_std[number]
            for chosen, ended in zip(actions[number], done[number], strict=True):
                cut = np.clip(chosen.astype(np.float64), world.spec.action_low, world.spec.action_high)
                observations = world.step(cut).observations
                lanes = np.flatnonzero(ended)
                if len(lanes):
                    observations[lanes] = world.reset(lanes)
        if not np.array_equal(observations, found.sent.observations, equal_nan=True):
            raise PerdureError("the same seeds and actions lead to other observations")
