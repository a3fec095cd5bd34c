"""What became of episodes, read from their logs alone: success, failure modes, placements. Nothing is simulated here.

Contents:
    write_logs, read_logs, write_records        logs as Parquet, see `schema`
    read_notes, noted_policies,                 what the writer of a file added to it: which policies acted, how the
    noted_hand_overs                            release strategy went
    record_of, EpisodeRecord, Target, Run       what is kept of an episode
    Event, Release, Track, FinalObject
    History                                     every pose at every step, for logs of other simulators
    latched, stabilizing, stages_stabilizing    both ways of counting, from a record
    placement_mechanism, label, outcome         why it failed; `mechanisms` holds the rules and thresholds
    analyze, Analysis                           all tables
    paired_difference                           two release strategies on the same episodes
    find_overlaps, Overlap                      objects at rest that lie inside each other
"""

from perdure.home.evaluate.outcomes.analysis import Analysis, analyze
from perdure.home.evaluate.outcomes.convert import episode_hash, record_of
from perdure.home.evaluate.outcomes.counting import latched, stabilizing, stage_steps, stages_stabilizing
from perdure.home.evaluate.outcomes.differences import paired_difference
from perdure.home.evaluate.outcomes.failure_causes import MECHANISMS, Mechanism, placement, placement_mechanism
from perdure.home.evaluate.outcomes.failures import COUNTINGS, Counting, Label, label, outcome
from perdure.home.evaluate.outcomes.files import (
    noted_hand_overs,
    noted_policies,
    read_logs,
    read_notes,
    write_logs,
    write_records,
)
from perdure.home.evaluate.outcomes.history import History
from perdure.home.evaluate.outcomes.overlaps import Overlap, find_overlaps
from perdure.home.evaluate.outcomes.records import (
    UNTRAINED,
    EpisodeRecord,
    Event,
    FinalObject,
    Release,
    Run,
    Target,
    Track,
)

__all__ = [
    "COUNTINGS",
    "MECHANISMS",
    "UNTRAINED",
    "Analysis",
    "Counting",
    "EpisodeRecord",
    "Event",
    "FinalObject",
    "History",
    "Label",
    "Mechanism",
    "Overlap",
    "Release",
    "Run",
    "Target",
    "Track",
    "analyze",
    "episode_hash",
    "find_overlaps",
    "label",
    "latched",
    "noted_hand_overs",
    "noted_policies",
    "outcome",
    "paired_difference",
    "placement",
    "placement_mechanism",
    "read_logs",
    "read_notes",
    "record_of",
    "stabilizing",
    "stage_steps",
    "stages_stabilizing",
    "write_logs",
    "write_records",
]
