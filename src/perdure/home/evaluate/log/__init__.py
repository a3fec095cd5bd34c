"""The log of an executed episode.

Contents:
    EpisodeLog                                  what is kept of an episode
    Target, SkillRun, Event, Release, Track,    its parts
    FinalObject
    History                                     every pose at every step, from which a log is made
"""

from perdure.home.evaluate.log.episode_log import (
    UNTRAINED,
    Ending,
    EpisodeLog,
    Event,
    FinalObject,
    Release,
    SkillRun,
    Target,
    Track,
)
from perdure.home.evaluate.log.history import History

__all__ = [
    "UNTRAINED",
    "Ending",
    "EpisodeLog",
    "Event",
    "FinalObject",
    "History",
    "Release",
    "SkillRun",
    "Target",
    "Track",
]
