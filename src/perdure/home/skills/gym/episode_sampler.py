"""Begins episodes: draws episode, target and start, and keeps the scenes that were built."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from perdure.home.benchmark.episodes import Episode
from perdure.home.sim.world import Scene, World, build_scene
from perdure.home.skills.gym.options import SkillEnvOptions
from perdure.home.skills.starts import begin


@lru_cache(maxsize=8)
def episode_sampler(options: SkillEnvOptions) -> EpisodeSampler:
    """Return the sampler of these options, kept: a learner that builds its worlds anew finds its scenes again."""
    return EpisodeSampler(options)


class EpisodeSampler:
    """Where lanes get their episodes from. What a lane gets depends on its own generator only."""

    def __init__(self, options: SkillEnvOptions) -> None:
        """Loads the episodes; with `train`, the very first time makes them, about a second for each."""
        self._options = options
        self.episodes = options.load()
        self._draw = options.draw
        self._scenes: dict[tuple[int, int], Scene] = {}

    def begin(self, world: World, lane: int, rng: np.random.Generator) -> Episode:
        """Starts an episode in a lane and tells which one."""
        number = int(rng.integers(len(self.episodes)))
        targets = self._options.chosen_targets
        target = targets[int(rng.integers(len(targets)))]
        episode = self.episodes[number]
        begin(world, lane, self.scene(number, target), self._draw, episode, target, rng)
        return episode

    def scene(self, number: int, target: int) -> Scene:
        """The scene of an episode with one target (and the clutter, if wanted); built once, 0.3 MB each."""
        key = number, target
        if key not in self._scenes:
            episode, options = self.episodes[number], replace(self._options.scene, targets=(target,))
            placements = [episode.objects[target]]
            if options.clutter:
                placements += episode.objects[len(episode.goals) :]
            self._scenes[key] = build_scene(episode.apartment(), placements, episode.opened, options)
        return self._scenes[key]
