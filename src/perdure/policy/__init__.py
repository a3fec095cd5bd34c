"""Policies: each is stored in one file with everything needed to act.

| file | what it holds |
|---|---|
| `policy.py` | `Policy`, its `Normalizer`, `TaskInfo` |
| `network.py` | the forward pass in NumPy, each row independent of the others |
| `closed_loop.py` | policies of any origin (`PolicyLike`, `FunctionPolicy`) acting in a world |
| `divergence.py` | simulations that diverged |
| `reference.py` | episodes within the training horizon |
| `files.py` | `save_policy`, `load_policy`, `find_policy`: one safetensors file with a checksum |
| `readers/` | models of Stable-Baselines3, sb3-contrib, CleanRL and rsl_rl |
| `onnx.py` | export to ONNX, and ONNX models as policies |
"""

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
from perdure.policy.files import find_policy, load_policy, save_policy, shipped_policies
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
    "find_policy",
    "load_policy",
    "measure_reference",
    "save_policy",
    "shipped_policies",
]
