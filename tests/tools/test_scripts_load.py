"""Scripts that no other test runs can at least be loaded as a user loads them."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("folder", ["benchmarks", "tools"])
def test_scripts_find_what_they_import(folder):
    """In a new process with only the scripts' folder on its path."""
    scripts = sorted(map(str, (ROOT / folder).glob("*.py")))
    assert scripts
    loads = "; ".join(f"runpy.run_path({script!r}, run_name='loaded')" for script in scripts)
    code = f"import runpy, sys; sys.path[0] = {str(ROOT / folder)!r}; {loads}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == 0, done.stderr
