"""The policy as an artifact: one file with everything needed to act.

| file | what it holds |
|---|---|
| `policy.py` | `Policy`, its `Normalizer` and what it was trained on (`TaskInfo`) |
| `network.py`, `activations.py`, `squash.py` | the forward pass in NumPy, each row independent of the others |
| `closed_loop.py` | policies acting in a world, lane by lane |
| `reference.py`, `measure.py` | what a policy does within its training horizon, and measuring it |
| `files.py` | `save_policy`, `load_policy`: one safetensors file, refused when damaged |
| `readers/` | policies of other libraries: models of Stable-Baselines3 |
| `shipped.py` | policies that come with the package, by name |
| `errors.py` | `PolicyError`, `PolicyFileError`, `PolicyWarning` |
"""

from perdure.policy.closed_loop import ClosedLoop, LanePolicy, LaneStep, check_fit
from perdure.policy.errors import PolicyError, PolicyFileError, PolicyWarning
from perdure.policy.files import load_policy, save_policy
from perdure.policy.measure import measure_reference
from perdure.policy.policy import Normalizer, Policy, TaskInfo
from perdure.policy.reference import Reference
from perdure.policy.shipped import find_policy, shipped_policies

__all__ = [
    "ClosedLoop",
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
