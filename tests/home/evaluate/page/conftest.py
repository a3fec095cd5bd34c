"""The stories of the outcomes' tests, and figures read as those of the report."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent / "outcomes"), str(HERE.parents[2] / "report")]
