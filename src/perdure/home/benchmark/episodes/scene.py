"""The scene of an episode: its apartment and objects as a compiled model."""

from __future__ import annotations

from functools import lru_cache

from perdure.home.benchmark.episodes.episode import Episode
from perdure.home.sim.world import Scene, SceneOptions, build_scene

MAX_CACHED = 512
"""Scenes, 0.3 MB each: those of 64 training episodes with five targets, or 100 published ones."""


def episode_scene(episode: Episode, options: SceneOptions | None = None) -> Scene:
    """Return the scene of an episode; the last ones asked for are kept and handed out again."""
    return _episode_scene(_Key(episode, options or SceneOptions()))


class _Key:
    """An episode is not hashable (its joint positions are a dictionary); its name and its content are."""

    def __init__(self, episode: Episode, options: SceneOptions) -> None:
        self.episode, self.options = episode, options
        self.identity = (episode.name, episode.objects, tuple(sorted(episode.opened.items())), options)

    def __hash__(self) -> int:
        return hash(self.identity)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and self.identity == other.identity


@lru_cache(maxsize=MAX_CACHED)
def _episode_scene(key: _Key) -> Scene:
    episode, options = key.episode, key.options
    count = len(episode.goals)
    wanted = range(count) if options.targets is None else options.targets
    placements = [episode.objects[k] for k in wanted]
    if options.clutter:
        placements += episode.objects[count:]
    return build_scene(episode.apartment(), placements, episode.opened, options)
