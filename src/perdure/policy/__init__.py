"""The policy as an artifact: one file with everything needed to act.

| file | what it holds |
|---|---|
| `policy.py` | `Policy` and its `Normalizer` |
| `task.py` | `TaskInfo`: what a policy was trained on |
| `actor.py` | `Actor`: anything that acts on rows of observations |
| `function.py` | `FunctionPolicy`: any function observations -> actions |
| `policy_lanes.py` | the running lanes of a `Policy` |
| `network.py`, `activations.py`, `squash.py` | the forward pass in NumPy, each row independent of the others |
| `closed_loop.py` | policies acting in a world, lane by lane |
| `reference.py`, `measure.py` | what a policy does within its training horizon, and measuring it |
| `files.py` | `save_policy`, `load_policy`: one safetensors file, refused when damaged |
| `readers/` | policies of other libraries: models of Stable-Baselines3 |
| `onnx/` | policies as ONNX models, and back |
| `shipped.py` | policies that come with the package, by name |
| `errors.py` | `PolicyError`, `PolicyFileError`, `PolicyWarning` |
"""

from perdure.policy.actor import ActingLanes, Actor
from perdure.policy.closed_loop import ClosedLoop, LanePolicy, LaneStep, check_fit
from perdure.policy.errors import PolicyError, PolicyFileError, PolicyWarning
from perdure.policy.files import load_policy, save_policy
from perdure.policy.function import FunctionPolicy
from perdure.policy.measure import measure_reference
from perdure.policy.policy import Normalizer, Policy
from perdure.policy.reference import Reference
from perdure.policy.shipped import find_policy, shipped_policies
from perdure.policy.task import TaskInfo

__all__ = [
    "ActingLanes",
    "Actor",
    "ClosedLoop",
    "FunctionPolicy",
    "LanePolicy",
    "LaneStep",
    "Normalizer",
    "Policy",
    "PolicyError",
    "PolicyFileError",
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
