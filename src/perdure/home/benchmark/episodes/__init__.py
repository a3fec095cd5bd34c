"""Episodes: where everything lies at the start and where the targets belong, made by rules and kept in files.

Contents:
    load_episodes                               the published ones: val and eval of each task
    Episode, EpisodeSet, episode_hash           what an episode is
    episode_scene                               its compiled model
    start_pose, start_poses                     the robot's start, drawn by the evaluation seed
    read_episodes, write_episodes               JSON with a schema and a hash
    generate_episodes, generate_episode         the generator; `ObjectModels` is what it asks about objects
    settle, settle_episode                      do the objects stay where they were put?
"""

from perdure.home.benchmark.episodes.episode import Episode, EpisodeSet, episode_hash
from perdure.home.benchmark.episodes.files import load_episodes, read_episodes, write_episodes
from perdure.home.benchmark.episodes.generate import PER_APARTMENT, generate_episode, generate_episodes
from perdure.home.benchmark.episodes.models import ObjectModels
from perdure.home.benchmark.episodes.scene import episode_scene
from perdure.home.benchmark.episodes.settle import settle, settle_episode
from perdure.home.benchmark.episodes.start import start_pose, start_poses

__all__ = [
    "PER_APARTMENT",
    "Episode",
    "EpisodeSet",
    "ObjectModels",
    "episode_hash",
    "episode_scene",
    "generate_episode",
    "generate_episodes",
    "load_episodes",
    "read_episodes",
    "settle",
    "settle_episode",
    "start_pose",
    "start_poses",
    "write_episodes",
]
