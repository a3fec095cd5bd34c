import importlib
import subprocess
import sys

import pytest

PACKAGES = (
    "perdure.home",
    "perdure.home.sim.apartments",
    "perdure.home.benchmark.tasks",
    "perdure.home.benchmark.episodes",
)


@pytest.mark.parametrize("name", PACKAGES)
def test_every_public_name_exists(name):
    package = importlib.import_module(name)
    assert all(hasattr(package, public) for public in package.__all__)
    assert list(package.__all__) == sorted(package.__all__, key=lambda n: (not n.isupper(), not n[0].isupper(), n))


def test_importing_the_package_imports_nothing_heavy():
    heavy = "{'mujoco', 'scipy', 'altair', 'gymnasium', 'jax', 'polars'}"
    code = f"import sys, perdure.home; print(sorted({heavy} & set(sys.modules)))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
