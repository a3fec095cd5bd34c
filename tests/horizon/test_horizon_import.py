"""The package is light, and its table of contents is true."""

import subprocess
import sys
from pathlib import Path

import pytest

import perdure.horizon
import perdure.horizon.wrappers

HEAVY = ("gymnasium", "jax", "envpool", "polars", "altair", "scipy", "torch", "stable_baselines3")


def loaded_by(statement):
    script = f"import sys; {statement}; print([name for name in {HEAVY} if name in sys.modules])"
    return eval(subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout)


def test_importing_the_package_loads_none_of_the_heavy_libraries():
    assert loaded_by("import perdure.horizon") == []


def test_importing_the_wrappers_loads_gymnasium_and_no_learner():
    loaded = loaded_by("import perdure.horizon.wrappers")
    assert "gymnasium" in loaded
    assert not {"jax", "envpool", "torch", "stable_baselines3"} & set(loaded)


@pytest.mark.parametrize("package", [perdure.horizon, perdure.horizon.wrappers], ids=lambda package: package.__name__)
def test_every_public_name_exists_and_every_file_is_in_the_table_of_contents(package):
    assert all(hasattr(package, name) for name in package.__all__)
    assert package.__all__ == sorted(package.__all__)
    files = {path.name for path in Path(package.__file__).parent.glob("*.py")} - {"__init__.py"}
    assert {name for name in files if f"`{name}`" not in package.__doc__} == set()
