"""Read policies of other libraries without running the code in their files."""

from perdure.policy.readers.checkpoints import import_cleanrl, import_rsl_rl
from perdure.policy.readers.sb3_import import FoundModel, find_models, import_file, import_once, import_sb3

__all__ = ["FoundModel", "find_models", "import_cleanrl", "import_file", "import_once", "import_rsl_rl", "import_sb3"]
