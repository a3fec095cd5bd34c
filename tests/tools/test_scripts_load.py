"""Scripts that no other test runs can at least be loaded as a user loads them."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPTS = sorted(path for folder in ("benchmarks", "tools") for path in (ROOT / folder).glob("*.py"))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_a_script_finds_what_it_imports(script):
    """In a new process with only the script's folder on its path."""
    load = f"runpy.run_path({str(script)!r}, run_name='loaded')"
    code = f"import runpy, sys; sys.path[0] = {str(script.parent)!r}; {load}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == 0, done.stderr
