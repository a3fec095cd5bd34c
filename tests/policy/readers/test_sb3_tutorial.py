"""The commands of docs/tutorials/does-my-sb3-agent-hold.md, on the models among the fixtures and, long, on its own."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import pytest

from perdure import cli

FIXTURES = Path(__file__).parent / "fixtures"
PAGE = Path(__file__).parents[3] / "docs" / "tutorials" / "does-my-sb3-agent-hold.md"
BLOCKS = re.findall(r"^<!-- test: elsewhere; [^\n]*\n```(\w+)\n(.*?)^```", PAGE.read_text(), re.MULTILINE | re.DOTALL)
COMMANDS = [text for language, text in BLOCKS if language == "sh"]
TRAINING, USE = [text for language, text in BLOCKS if language == "python"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder that holds the models under the names of the page."""
    folder = tmp_path_factory.mktemp("tutorial")
    for source, name in (("ppo.zip", "model.zip"), ("ppo.pkl", "vecnormalize.pkl"), ("sac-time.zip", "timed.zip")):
        shutil.copy(FIXTURES / source, folder / name)
    return folder


def run(command, folder, monkeypatch, capsys):
    """Run commands of the page in this process and return what they print."""
    monkeypatch.chdir(folder)
    for line in command.replace("\\\n", "").strip().splitlines():
        cli.run(shlex.split(line)[1:])
    return capsys.readouterr().out


def short(command):
    """The same evaluation with few and short episodes."""
    command = re.sub(r" (\\\n)? *--(steps|eval-seeds) \d+", "", command)
    few = "--steps 60 --eval-seeds 1 --disturb none --on here --out"
    return command.replace("--out", few) if "extrapolate" in command else command


def test_the_page_has_the_commands_that_are_tested():
    assert [command.split()[1] for command in COMMANDS] == ["extrapolate", "extrapolate", "extrapolate", "import"]
    assert "--steps 60 --eval-seeds 1" in short(COMMANDS[0])
    assert "10000" not in short(COMMANDS[0])


@pytest.mark.parametrize("number", range(len(COMMANDS)))
def test_a_command_of_the_page_runs(number, folder, monkeypatch, capsys):
    output = run(short(COMMANDS[number]), folder, monkeypatch, capsys)
    assert ("Report:" in output) == ("extrapolate" in COMMANDS[number])


def test_the_python_of_the_page_runs(folder, monkeypatch):
    monkeypatch.chdir(folder)
    exec(compile(USE, PAGE.name, "exec"), {})


@pytest.mark.verify
def test_the_page_as_a_whole_from_training_to_the_verdict(tmp_path, monkeypatch, capsys):
    pytest.importorskip("stable_baselines3")
    monkeypatch.chdir(tmp_path)
    exec(compile(TRAINING, PAGE.name, "exec"), {})
    assert "holds for 10,000 steps" in run(COMMANDS[0], tmp_path, monkeypatch, capsys)
