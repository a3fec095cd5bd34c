"""Outcomes of episodes from their logs alone: success, failure modes, placements. Nothing is simulated here.

Contents:
    write_logs, read_logs                       logs as Parquet, see `schema`
    read_notes, noted_policies,                 what the writer of a file added to it: the policies, the outcomes of
    noted_hand_overs                            the release strategy
    latched, stabilizing, stages_stabilizing    both ways of counting, from a record
    placement_cause, label, outcome         why it failed; `failure_causes` holds the rules and thresholds
    analyze, Analysis                           all tables
    paired_difference                           two release strategies on the same episodes
    find_overlaps, Overlap                      objects at rest that lie inside each other
"""

from perdure.home.evaluate.outcomes.analysis import Analysis, analyze
from perdure.home.evaluate.outcomes.counting import latched, stabilizing, stages_stabilizing
from perdure.home.evaluate.outcomes.differences import paired_difference
from perdure.home.evaluate.outcomes.failure_causes import FAILURE_CAUSES, FailureCause, placement, placement_cause
from perdure.home.evaluate.outcomes.files import noted_hand_overs, noted_policies, read_logs, read_notes, write_logs
from perdure.home.evaluate.outcomes.labels import COUNTINGS, Counting, Label, label, outcome
from perdure.home.evaluate.outcomes.overlaps import Overlap, find_overlaps

__all__ = [
    "COUNTINGS",
    "FAILURE_CAUSES",
    "Analysis",
    "Counting",
    "FailureCause",
    "Label",
    "Overlap",
    "analyze",
    "find_overlaps",
    "label",
    "latched",
    "noted_hand_overs",
    "noted_policies",
    "outcome",
    "paired_difference",
    "placement",
    "placement_cause",
    "read_logs",
    "read_notes",
    "stabilizing",
    "stages_stabilizing",
    "write_logs",
]
