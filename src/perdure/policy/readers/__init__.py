"""Read policies of other libraries without running the code in their files.

| file | what it holds |
|---|---|
| `sb3_import.py` | `import_sb3`: a Stable-Baselines3 model and its `VecNormalize`, checked; models in folders |
| `sb3.py` | the zip: its layers, and its settings |
| `checkpoints.py` | `import_cleanrl`: CleanRL's ppo_continuous_action; `import_rsl_rl`: a checkpoint of rsl_rl |
| `restricted_pickle.py` | a pickle as data: the arrays in it, and the tensors of a PyTorch state dict |
| `trusted.py` | the same through Stable-Baselines3 itself, for files that the user trusts |
"""

from perdure.policy.readers.checkpoints import import_cleanrl, import_rsl_rl
from perdure.policy.readers.sb3_import import FoundModel, find_models, import_file, import_once, import_sb3

__all__ = ["FoundModel", "find_models", "import_cleanrl", "import_file", "import_once", "import_rsl_rl", "import_sb3"]
