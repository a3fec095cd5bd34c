"""The types are right: mypy runs beside the other tests, because from an empty cache it takes a minute."""

import subprocess
import sys
from pathlib import Path


def test_the_types_of_the_package_and_the_studies_are_right():
    checked = subprocess.run(
        [sys.executable, "-m", "mypy"], cwd=Path(__file__).parents[1], capture_output=True, text=True
    )
    assert checked.returncode == 0, checked.stdout + checked.stderr
