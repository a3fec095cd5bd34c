"""The policy as an artifact: one file with everything needed to act.

| file | what it holds |
|---|---|
| `policy.py` | `Policy`, its `Normalizer` and what it was trained on (`TaskInfo`) |
| `network.py` | the forward pass in NumPy, each row independent of the others |
| `closed_loop.py` | policies acting in a world, lane by lane |
| `files.py` | `save_policy`, `load_policy`: one safetensors file, refused when damaged |
| `errors.py` | `PolicyError`, `PolicyFileError` |
"""

from perdure.policy.closed_loop import ClosedLoop, Moment, Pilot, check_fit
from perdure.policy.errors import PolicyError, PolicyFileError
from perdure.policy.files import load_policy, save_policy
from perdure.policy.policy import Normalizer, Policy, TaskInfo

__all__ = [
    "ClosedLoop",
    "Moment",
    "Normalizer",
    "Pilot",
    "Policy",
    "PolicyError",
    "PolicyFileError",
    "TaskInfo",
    "check_fit",
    "load_policy",
    "save_policy",
]
