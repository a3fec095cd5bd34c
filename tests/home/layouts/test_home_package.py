import importlib
import subprocess
import sys

import pytest

PACKAGES = ("perdure.home", "perdure.home.layouts", "perdure.home.tasks", "perdure.home.episodes")


@pytest.mark.parametrize("name", PACKAGES)
def test_every_public_name_exists(name):
    package = importlib.import_module(name)
    assert all(hasattr(package, public) for public in package.__all__)
    assert list(package.__all__) == sorted(package.__all__, key=lambda n: (not n.isupper(), not n[0].isupper(), n))


def test_importing_the_package_imports_nothing_heavy():
    heavy = "{'mujoco', 'scipy', 'matplotlib', 'gymnasium', 'jax', 'polars'}"
    code = f"import sys, perdure.home; print(sorted({heavy} & set(sys.modules)))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_imports_within_home_point_downwards():
    """layouts and tasks know nothing of episodes, layouts and tasks nothing of each other."""
    code = (
        "import sys, importlib; sys.modules['perdure.home'] = type(sys)('perdure.home');"
        "sys.modules['perdure.home'].__path__ = [{path!r}];"
        "importlib.import_module('perdure.home.{name}');"
        "print(sorted(m.split('.')[2] for m in sys.modules if m.count('.') == 2 and m.startswith('perdure.home.')))"
    )
    path = importlib.import_module("perdure.home").__path__[0]
    for name, allowed in (("layouts", {"layouts", "errors"}), ("tasks", {"tasks", "errors"})):
        command = [sys.executable, "-c", code.format(path=path, name=name)]
        found = subprocess.run(command, capture_output=True, text=True, check=True)
        assert set(eval(found.stdout)) == allowed
