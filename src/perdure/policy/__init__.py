"""Policies: each is stored in one file with everything needed to act."""

from perdure.policy.closed_loop import (
    ActingEpisodes,
    ClosedLoop,
    EpisodePolicy,
    FunctionPolicy,
    LoopStep,
    PolicyLike,
    check_fit,
)
from perdure.policy.divergence import DivergenceDetector
from perdure.policy.files import find_policies, find_policy, load_policy, save_policy, shipped_policies
from perdure.policy.policy import Normalizer, Policy, TaskInfo
from perdure.policy.reference import Reference, measure_reference

__all__ = [
    "ActingEpisodes",
    "ClosedLoop",
    "DivergenceDetector",
    "EpisodePolicy",
    "FunctionPolicy",
    "LoopStep",
    "Normalizer",
    "Policy",
    "PolicyLike",
    "Reference",
    "TaskInfo",
    "check_fit",
    "find_policies",
    "find_policy",
    "load_policy",
    "measure_reference",
    "save_policy",
    "shipped_policies",
]
