"""Every code block of README, CONTRIBUTING and the site runs, or says why it cannot."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from snippets import ROOT, Block, blocks, commands, faults, indented_commands, pages

import perdure

PAGES = {str(path.relative_to(ROOT)): list(blocks(path.read_text(), path.relative_to(ROOT))) for path in pages()}
BLOCKS = [block for page in PAGES.values() for block in page]


def session(page, folder, verbs):
    """Run the blocks of a page in order, in one folder: python in one namespace, shell commands in bash.

    Returns what was left out because a module is not installed, as sentences.
    """
    module = ModuleType("snippets_of_a_page")
    sys.modules[module.__name__] = module  # where dataclasses look their module up
    left_out = []
    for block in page:
        missing = [name for name in block.modules if importlib.util.find_spec(name) is None]
        if block.verb in verbs and missing:
            left_out.append(f"{block.where} needs {', '.join(missing)}")
        elif block.verb.startswith("file "):
            (folder / block.verb.removeprefix("file ")).write_text(block.code)
        elif block.verb not in verbs:
            continue
        elif block.language == "python":
            exec(compile(block.code, block.where, "exec"), module.__dict__)
        else:
            shell(commands(block), folder, block.where)
    return left_out


def shell(script, folder, where):
    """Run a script with `perdure` and `python` of this environment, and the source under test."""
    paths = [str(Path(sys.executable).parent), os.environ["PATH"]]
    source = [str(Path(perdure.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    variables = {**os.environ, "PATH": os.pathsep.join(paths), "PYTHONPATH": os.pathsep.join(filter(None, source))}
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", script], cwd=folder, env=variables, capture_output=True, text=True
    )
    assert done.returncode == 0, f"{where}: {done.stderr[-2000:]}"


def names(verb):
    return [name for name, page in PAGES.items() if any(block.verb == verb for block in page)]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", PAGES)
def test_every_block_says_how_it_is_tested(name):
    assert [fault for block in PAGES[name] for fault in faults(block)] == []


@pytest.mark.parametrize("name", PAGES)
def test_no_command_hides_in_indented_code(name):
    assert indented_commands((ROOT / name).read_text()) == []


@pytest.mark.parametrize("name", names("run"))
def test_quick_blocks_run(name, folder):
    if left_out := session(PAGES[name], folder, {"run"}):
        pytest.skip("; ".join(left_out))


@pytest.mark.verify
@pytest.mark.parametrize("name", names("verify"))
def test_long_blocks_run(name, folder):
    if left_out := session(PAGES[name], folder, {"run", "verify"}):
        pytest.skip("; ".join(left_out))


PLANTED = {
    "no mark": "```python\n1 / 0\n```\n",
    "no language": "<!-- test: run -->\n```\nperdure list\n```\n",
    "no such mark": "<!-- test: maybe -->\n```sh\ntrue\n```\n",
    "no reason": "<!-- test: skip -->\n```sh\nrm x\n```\n",
    "no such test": "<!-- test: elsewhere; tests/test_nothing.py -->\n```python\nx\n```\n",
    "replaces nothing": "<!-- test: run; --steps 9 => --steps 1 -->\n```sh\nperdure list\n```\n",
    "in a list": "- item\n\n  ```sh\n  perdure list\n  ```\n",
}


@pytest.mark.parametrize("text", PLANTED.values(), ids=PLANTED)
def test_a_planted_fault_is_found(text):
    (block,) = blocks(text, "page.md")
    assert len(list(faults(block))) == 1


def test_a_planted_indented_command_is_found():
    text = "1. Look:\n\n       perdure inspect x\n\n```sh\n    perdure list\n```\n    hold = rate / idle\n"
    assert indented_commands(text) == ["perdure inspect x"]


def test_a_sound_page_runs_in_order_with_its_replacements(folder):
    text = (
        "<!-- test: file helper.py -->\n```python\nvalue = 41\n```\n"
        "<!-- test: run; + 2 => + 1 -->\n```python\nfrom helper import value\nresult = value + 2\n```\n"
        "<!-- test: run -->\n```python\nopen('result', 'w').write(str(result))\n```\n"
        "<!-- test: verify -->\n```sh\nfalse\n```\n"
        "<!-- test: run -->\n```console\n$ cp result copy\nprinted by nobody\n```\n"
        "```text\noutput\n```\n"
    )
    page = list(blocks(text, "page.md"))
    assert [fault for block in page for fault in faults(block)] == []
    session(page, folder, {"run"})
    assert (folder / "copy").read_text() == "42"


@pytest.mark.parametrize(("language", "code"), [("python", "1 / 0"), ("sh", "false\ntrue")])
def test_a_failing_block_fails(folder, language, code):
    with pytest.raises((ZeroDivisionError, AssertionError)):
        session([Block("page.md:1", language, code, "run")], folder, {"run"})
