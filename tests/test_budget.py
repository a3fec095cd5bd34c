"""The house stays small. Limits may only be lowered; a new capability pays for its lines with others."""

import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
CODE = ("src", "studies", "benchmarks", "tools")
MOST_LINES = 35_766
"""Lines of Python in CODE."""
MOST_FILES = 164
"""Python files in CODE."""
MOST_WORDS = 28_595
"""Words, as `wc -w` counts them, of README, CONTRIBUTING, CHANGELOG and the pages in docs and results."""
MOST_TABLES = 25e6
"""Bytes of tables and figures in results."""
MOST_POLICIES = 80e6
"""Bytes of policies in results."""
GENERATED = ("docs/_build", "docs/reference/api", "docs/reference/cli.md", "docs/home/skills.md")


def tracked(root=ROOT):
    """The files of the repository that exist; all files where this is no clone."""
    try:
        listed = subprocess.run(["git", "ls-files", "-z"], cwd=root, capture_output=True, text=True, check=True).stdout
        names = [name for name in listed.split("\0") if name]
    except (OSError, subprocess.CalledProcessError):
        names = []
    if not names:
        folders = (*CODE, "docs", "results")
        names = [f"{each}/{name}" for each in folders for name in walk(root / each)] + os.listdir(root)
    return {name: root / name for name in names if (root / name).is_file() and not name.startswith(GENERATED)}


def walk(folder):
    return [str(path.relative_to(folder)) for path in folder.rglob("*")]


def suffixes(files, folders, *ends):
    return [path for name, path in files.items() if name.split("/")[0] in folders and name.endswith(ends)]


def measure(files):
    """What the limits are about, by name."""
    code = suffixes(files, CODE, ".py")
    pages = [files[name] for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md") if name in files]
    pages += suffixes(files, ("docs", "results"), ".md")
    return {
        "lines": sum(path.read_bytes().count(b"\n") for path in code),
        "files": len(code),
        "words": sum(len(path.read_text(encoding="utf-8").split()) for path in pages),
        "tables": sum(
            path.stat().st_size for path in suffixes(files, ("results",), ".csv", ".parquet", ".svg", ".json", ".png")
        ),
        "policies": sum(path.stat().st_size for path in suffixes(files, ("results",), ".safetensors")),
    }


@pytest.mark.parametrize(
    ("what", "most"),
    [
        ("lines", MOST_LINES),
        ("files", MOST_FILES),
        ("words", MOST_WORDS),
        ("tables", MOST_TABLES),
        ("policies", MOST_POLICIES),
    ],
)
def test_the_budget_holds(what, most):
    assert measure(tracked())[what] <= most


def test_what_counts(tmp_path):
    """In a folder that is no clone."""
    contents = {
        "src/a.py": "x = 1\ny = 2\n",
        "src/a.txt": "no code",
        "tests/b.py": "not counted\n",
        "README.md": "two words",
        "SECURITY.md": "not counted",
        "docs/c.md": "one",
        "docs/_build/c.md": "generated",
        "results/d/e.md": "| two",
        "results/d/e.csv": "1,2\n",
        "results/d/e.safetensors": "ab",
    }
    for name, text in contents.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    assert measure(tracked(tmp_path)) == {"lines": 2, "files": 1, "words": 5, "tables": 4, "policies": 2}
