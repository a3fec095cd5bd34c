"""Draws episode, target and start state for each new episode of a lane."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from perdure.home.benchmark.episodes import Episode, episode_scene
from perdure.home.sim.world import Scene, VectorSimulator
from perdure.home.skills.gym.options import SkillEnvOptions
from perdure.home.skills.starts import begin


@lru_cache(maxsize=8)
def episode_sampler(options: SkillEnvOptions) -> EpisodeSampler:
    """Return the cached sampler of these options, so that a learner that rebuilds its worlds loads them once."""
    return EpisodeSampler(options)


class EpisodeSampler:
    """Draws the episodes of lanes. A draw depends on the lane's own generator only."""

    def __init__(self, options: SkillEnvOptions) -> None:
        """Load the episodes; those of `train` are generated the first time, which needs about a second for each."""
        self._options = options
        self.episodes = options.load()
        self._draw = options.make_skill().draw_start

    def begin(self, world: VectorSimulator, lane: int, rng: np.random.Generator) -> Episode:
        """Begin an episode in a lane and return it."""
        number = int(rng.integers(len(self.episodes)))
        targets = self._options.chosen_targets
        target = targets[int(rng.integers(len(targets)))]
        episode = self.episodes[number]
        begin(world, lane, self.scene(number, target), self._draw, episode, target, rng)
        return episode

    def scene(self, number: int, target: int) -> Scene:
        """Return the scene of an episode with one target and, if wanted, the clutter."""
        return episode_scene(self.episodes[number], replace(self._options.scene, targets=(target,)))
