"""The policy as an artifact: one file with everything needed to act.

| file | what it holds |
|---|---|
| `policy.py` | `Policy`, its `Normalizer` and what it was trained on (`TaskInfo`) |
| `network.py` | the forward pass in NumPy, each row independent of the others |
| `files.py` | `save_policy`, `load_policy`: one safetensors file, refused when damaged |
| `errors.py` | `PolicyError`, `PolicyFileError` |
"""

from perdure.policy.errors import PolicyError, PolicyFileError
from perdure.policy.files import load_policy, save_policy
from perdure.policy.policy import Normalizer, Policy, TaskInfo

__all__ = ["Normalizer", "Policy", "PolicyError", "PolicyFileError", "TaskInfo", "load_policy", "save_policy"]
