import subprocess
import sys

import perdure.home


def test_every_public_name_exists():
    assert all(hasattr(perdure.home, public) for public in perdure.home.__all__)


def test_importing_the_package_imports_nothing_heavy():
    heavy = "{'mujoco', 'scipy', 'altair', 'gymnasium', 'jax', 'polars'}"
    code = f"import sys, perdure.home; print(sorted({heavy} & set(sys.modules)))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
