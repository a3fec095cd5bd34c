"""Every package is its own table of contents, importing is light, and what is public is documented."""

import importlib
import importlib.metadata
import subprocess
import sys
from pathlib import Path

import pytest

import perdure

ROOT = Path(perdure.__file__).parent
HEAVY = ("altair", "envpool", "gymnasium", "jax", "mujoco", "polars", "rich", "scipy", "tyro", "vl_convert")


def module_name(path):
    parts = path.relative_to(ROOT.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


PACKAGES = sorted(module_name(path) for path in ROOT.rglob("__init__.py"))
FILES = sorted(ROOT.rglob("*.py"))


@pytest.mark.parametrize("name", PACKAGES)
def test_every_name_a_package_offers_exists(name):
    package = importlib.import_module(name)
    offered = getattr(package, "__all__", [])
    assert [public for public in offered if not hasattr(package, public)] == []
    assert len(offered) == len(set(offered))


ALONE = """
import importlib, sys
for name in sys.argv[1:]:
    for known in [known for known in sys.modules if known.split(".")[0] == "perdure"]:
        del sys.modules[known]
    importlib.import_module(name)
"""


def test_every_package_can_be_imported_first():
    """Packages that import one another in a circle work in one order only."""
    done = subprocess.run([sys.executable, "-c", ALONE, *PACKAGES], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_an_unknown_name_is_no_attribute():
    assert not hasattr(perdure, "Horizont")


def test_no_public_name_of_perdure_hides_one_of_its_packages():
    """Otherwise what the name means would depend on what was imported before."""
    assert [name for name in perdure.__all__ if (ROOT / name).is_dir() or (ROOT / f"{name}.py").exists()] == []


@pytest.mark.parametrize(
    "statement", ["import perdure", "import perdure.horizon", "import perdure.report", "import perdure.runs"]
)
def test_importing_loads_no_heavy_library(statement):
    script = f"import sys; {statement}; print(*[name for name in {HEAVY} if name in sys.modules])"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert loaded.stdout.split() == []


def test_the_version_is_the_installed_one():
    assert perdure.__version__ == importlib.metadata.version("perdure")
