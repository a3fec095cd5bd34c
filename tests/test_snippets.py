"""Code blocks of the README and the tutorials run, in order and in one folder, as a reader would run them.

A comment above a block says how it is tested:

    <!-- test: run -->                       always; python in one namespace for the page, sh in bash
    <!-- test: verify; 1e5 => 500 -->        only in `make verify`, here with a shorter setting
    <!-- test: file corridor.py -->          the reader saves the block under this name
    <!-- test: elsewhere; tests/test_x.py --> that test runs it
    <!-- test: skip; reason -->              cannot run here

`A => B` replaces A, which must occur in the block; `needs MODULE` leaves the block out where a module is not installed.
"""

import importlib.util
import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import pytest

import perdure

ROOT = Path(__file__).parents[1]
FENCE = re.compile(r"^```(?P<language>[^\n`]*)\n(?P<body>.*?)^```[ ]*$", re.MULTILINE | re.DOTALL)
MARK = re.compile(r"<!-- test: ((?:(?!-->).)*) -->\s*$", re.DOTALL)


@dataclass(frozen=True)
class Block:
    """One code block of a page: place, language, text, mark (run, verify, ...) and what follows the mark."""

    where: str
    language: str
    text: str
    verb: str
    details: tuple[str, ...] = ()

    @property
    def replacements(self):
        return [tuple(part.strip() for part in each.split("=>")) for each in self.details if "=>" in each]

    @property
    def code(self):
        code = self.text
        for old, new in self.replacements:
            code = code.replace(old, new)
        return code

    @property
    def missing(self):
        needed = [each.removeprefix("needs ") for each in self.details if each.startswith("needs ")]
        return [name for name in needed if importlib.util.find_spec(name) is None]


def blocks(text, where):
    """The code blocks of a page, in order, without those of plain text."""
    for found in FENCE.finditer(text):
        if found["language"] == "text":
            continue
        mark = MARK.search(text[: found.start()])
        verb, *details = [part.strip() for part in mark[1].split(";")] if mark else [""]
        line = text[: found.start()].count("\n") + 1
        yield Block(f"{where}:{line}", found["language"], found["body"], verb, tuple(details))


def faults(block):
    """What is wrong with a block's language or mark, as sentences."""
    verb = block.verb.split(" ")[0]
    if block.language not in ("python", "sh") or verb not in ("run", "verify", "file", "elsewhere", "skip"):
        yield f"{block.where}: {block.language!r} block with the mark {block.verb!r}"
    if verb == "skip" and not block.details:
        yield f"{block.where}: a skipped block needs a reason"
    if verb == "elsewhere" and not any((ROOT / each).is_file() for each in block.details):
        yield f"{block.where}: no test file in {block.details}"
    for old, _ in block.replacements:
        if old not in block.text:
            yield f"{block.where}: {old!r} is not in the block"


def session(page, folder, verbs):
    """Run the blocks of a page with these marks; return what was left out because a module is not installed."""
    module = ModuleType("snippets_of_a_page")
    sys.modules[module.__name__] = module  # where dataclasses look their module up
    left_out = []
    for block in page:
        if block.verb.startswith("file "):
            (folder / block.verb.removeprefix("file ")).write_text(block.code)
        elif block.verb in verbs and block.missing:
            left_out.append(f"{block.where} needs {', '.join(block.missing)}")
        elif block.verb in verbs and block.language == "python":
            exec(compile(block.code, block.where, "exec"), module.__dict__)
        elif block.verb in verbs:
            shell(block, folder)
    return left_out


def shell(block, folder):
    """Run a script with `perdure` and `python` of this environment, and the source under test."""
    paths = [str(Path(sys.executable).parent), os.environ["PATH"]]
    source = [str(Path(perdure.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    variables = {**os.environ, "PATH": os.pathsep.join(paths), "PYTHONPATH": os.pathsep.join(filter(None, source))}
    command = ["bash", "-euo", "pipefail", "-c", block.code]
    done = subprocess.run(command, cwd=folder, env=variables, capture_output=True, text=True)
    assert done.returncode == 0, f"{block.where}: {done.stderr[-2000:]}"


PAGES = {
    str(path.relative_to(ROOT)): list(blocks(path.read_text(), path.relative_to(ROOT)))
    for path in (ROOT / "README.md", *sorted((ROOT / "docs" / "tutorials").glob("*.md")))
}


def names(verb):
    return [name for name, page in PAGES.items() if any(block.verb == verb for block in page)]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def test_every_block_says_how_it_is_tested():
    assert [fault for page in PAGES.values() for block in page for fault in faults(block)] == []


@pytest.mark.parametrize("name", names("run"))
def test_quick_blocks_run(name, folder):
    if left_out := session(PAGES[name], folder, {"run"}):
        pytest.skip("; ".join(left_out))


@pytest.mark.verify
@pytest.mark.parametrize("name", names("verify"))
def test_long_blocks_run(name, folder):
    if left_out := session(PAGES[name], folder, {"run", "verify"}):
        pytest.skip("; ".join(left_out))
