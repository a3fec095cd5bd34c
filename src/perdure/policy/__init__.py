"""Policies: each is stored in one file with everything needed to act.

| file | what it holds |
|---|---|
| `policy.py` | `Policy` and its `Normalizer` |
| `task.py` | `TaskInfo`: the task that a policy was trained on |
| `policy_like.py` | `PolicyLike`: interface of policies, which act on rows of observations |
| `function.py` | `FunctionPolicy`: any function observations -> actions |
| `policy_lanes.py` | the running lanes of a `Policy` |
| `network.py`, `activations.py`, `squash.py` | the forward pass in NumPy, each row independent of the others |
| `closed_loop.py` | policies acting in a world |
| `divergence.py` | detecting simulations that diverged |
| `reference.py`, `measure.py` | episodes within the training horizon, and how to record them |
| `files.py` | `save_policy`, `load_policy`: one safetensors file with a checksum |
| `schema.py` | what a policy file may contain |
| `hub.py` | policies in folders and in the cache of Hugging Face |
| `one_thread.py` | matrix products on one thread, for reproducible results |
| `readers/` | models of Stable-Baselines3, sb3-contrib and CleanRL |
| `onnx/` | export to and import from ONNX |
| `shipped.py` | policies that come with the package, by name |
| `errors.py` | `PolicyError`, `PolicyFileError`, `PolicyWarning` |
"""

from perdure.policy.closed_loop import ClosedLoop, LanePolicy, LaneStep, check_fit
from perdure.policy.errors import PolicyError, PolicyFileError, PolicyWarning
from perdure.policy.files import load_policy, save_policy
from perdure.policy.function import FunctionPolicy
from perdure.policy.measure import measure_reference
from perdure.policy.policy import Normalizer, Policy
from perdure.policy.policy_like import ActingLanes, PolicyLike
from perdure.policy.reference import Reference
from perdure.policy.shipped import find_policy, shipped_policies
from perdure.policy.task import TaskInfo

__all__ = [
    "ActingLanes",
    "ClosedLoop",
    "FunctionPolicy",
    "LanePolicy",
    "LaneStep",
    "Normalizer",
    "Policy",
    "PolicyError",
    "PolicyFileError",
    "PolicyLike",
    "PolicyWarning",
    "Reference",
    "TaskInfo",
    "check_fit",
    "find_policy",
    "load_policy",
    "measure_reference",
    "save_policy",
    "shipped_policies",
]
