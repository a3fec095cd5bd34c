"""Stories of the outcomes' tests are told here, too, and figures are read as those of the report."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent / "outcomes"), str(HERE.parents[2] / "report")]
