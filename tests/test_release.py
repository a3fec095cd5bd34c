"""A release is consistent, and works from its wheel."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import perdure

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
NOT_SOURCE = (".git", ".venv*", "build", "dist", "demo", "runs", "home-runs", "results")
"""Folders beside the source; inside the package such a name is source."""


def test_every_file_names_the_same_version():
    citation = re.search(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)[1]
    changes = re.findall(r"^## \[(\d.*?)\]", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert {PROJECT["version"], citation, changes[0], perdure.__version__} == {perdure.__version__}


def test_the_citation_has_what_the_format_asks_for():
    text = (ROOT / "CITATION.cff").read_text()
    keys = set(re.findall(r"^([a-z-]+):", text, re.MULTILINE))
    assert {"cff-version", "message", "title", "authors"} <= keys
    references = re.split(r"^  - ", text.partition("references:")[2], flags=re.MULTILINE)[1:]
    assert references
    assert all(
        {"type", "authors", "title"} <= set(re.findall(r"^(?:    )?(\w+):", each, re.MULTILINE)) for each in references
    )
    assert f"license: {PROJECT['license']}" in text


def test_continuous_integration_covers_every_python_version_that_the_package_names():
    workflow = (ROOT / ".github" / "workflows" / "ci.yml").read_text()
    tested = re.findall(r'"(3\.\d+)"', re.search(r"^ +python: (\[.*\])$", workflow, re.MULTILINE)[1])
    named = [each.rpartition(" ")[2] for each in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", each)]
    assert tested == named
    assert PROJECT["requires-python"] == f">={tested[0]}"


@pytest.fixture(scope="module")
def fresh(tmp_path_factory):
    """The bin folder of a new virtual environment with the wheel in it, which was built from the sdist."""
    folder = tmp_path_factory.mktemp("release")
    beside, anywhere = (
        shutil.ignore_patterns(*NOT_SOURCE),
        shutil.ignore_patterns("*.egg-info", "_build", "__pycache__"),
    )
    shutil.copytree(
        ROOT,
        folder / "source",
        ignore=lambda where, names: anywhere(where, names) | (beside(where, names) if Path(where) == ROOT else set()),
        symlinks=True,
    )
    call(sys.executable, "-m", "build", "--outdir", folder / "dist", folder / "source")
    (wheel,) = (folder / "dist").glob("*.whl")
    assert (folder / "dist" / f"perdure-{perdure.__version__}.tar.gz").exists()
    call(sys.executable, "-m", "venv", folder / "venv")
    call(folder / "venv" / "bin" / "python", "-m", "pip", "install", "--quiet", f"{wheel}[home]")
    return folder / "venv" / "bin"


def call(*command):
    variables = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(command, cwd=ROOT, env=variables, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout


@pytest.mark.verify
def test_the_demo_runs_from_the_wheel(fresh, tmp_path):
    """`make demo` with the commands of the fresh environment, shortened; its own installation is left out."""
    where = call(fresh / "python", "-c", "import perdure; print(perdure.__file__)")
    assert Path(where).is_relative_to(fresh.parent)
    settings = ("DEMO_STEPS=400", "DEMO_SEEDS=2", "DEMO_EPISODES=1", f"DEMO_OUT={tmp_path / 'demo'}")
    call("make", "-o", "setup", "demo", f"BIN={fresh}", *settings)
    reports = {path.parent.name for path in (tmp_path / "demo").rglob("report.html")}
    assert {"Hopper-v3", "set_table"} <= reports
