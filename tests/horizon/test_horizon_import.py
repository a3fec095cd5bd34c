"""The time-to-go loads nothing heavy."""

import subprocess
import sys

import pytest

import perdure.horizon
import perdure.wrappers

HEAVY = ("gymnasium", "jax", "envpool", "polars", "altair", "scipy", "torch", "stable_baselines3")


def loaded_by(statement):
    script = f"import sys; {statement}; print([name for name in {HEAVY} if name in sys.modules])"
    return eval(subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout)


def test_importing_the_package_loads_none_of_the_heavy_libraries():
    assert loaded_by("import perdure.horizon") == []


def test_importing_the_wrappers_loads_gymnasium_and_no_learner():
    loaded = loaded_by("import perdure.wrappers")
    assert "gymnasium" in loaded
    assert not {"jax", "envpool", "torch", "stable_baselines3"} & set(loaded)


@pytest.mark.parametrize("package", [perdure.horizon, perdure.wrappers], ids=lambda package: package.__name__)
def test_every_public_name_exists(package):
    assert all(hasattr(package, name) for name in package.__all__)
    assert package.__all__ == sorted(package.__all__)
