"""Stories of the outcomes' tests are told here, too."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "outcomes"))
