"""Tests of hostile files use the builders of other tests."""

import sys
from pathlib import Path

TESTS = Path(__file__).parents[1]
sys.path[:0] = [
    str(Path(__file__).parent),
    *(str(TESTS / part) for part in ("policy", "report", "home/evaluate/outcomes", "home/tasks/episodes")),
]
