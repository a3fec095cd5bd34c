"""What CI jobs use: exit codes, one JSON document on stdout, functions and folders of other libraries as they are."""

from __future__ import annotations

import json
from collections import OrderedDict
from pathlib import Path

import polars as pl
import pytest
import yaml

FIXTURES = Path(__file__).parents[1] / "policy" / "readers" / "fixtures"
SHORT = ("--steps", 30, "--eval-seeds", 2, "--disturb", "action_noise:0.1")

POLICIES = """
import numpy as np
print("imported")

class Policies:
    @staticmethod
    def still(observations):
        print("asked")
        return np.zeros((len(observations), 1))
"""


@pytest.fixture(scope="module")
def evaluated(command, tmp_path_factory):
    """A folder in which a function was evaluated, and what the command said."""
    folder = tmp_path_factory.mktemp("evaluated")
    (folder / "my_cli_policies.py").write_text(POLICIES)
    flags = ("--env", "Pendulum-v1", *SHORT, "--json", "--require", "holds")
    return folder, command("extrapolate", "my_cli_policies:Policies.still", *flags, cwd=folder)


def test_stdout_is_one_document_whatever_the_function_prints(evaluated):
    folder, process = evaluated
    document = json.loads(process.stdout)
    assert "imported" in process.stderr
    assert "asked" in process.stderr
    assert Path(document["page"]).is_file()
    frame = pl.read_parquet(document["table"])
    assert frame["task"][0] == document["groups"][0]["task"]
    assert (folder / "extrapolation").resolve() == Path(document["table"]).parent


def test_what_is_required_decides_the_exit_code_and_is_named(evaluated):
    _, process = evaluated
    document = json.loads(process.stdout)
    assert (process.returncode, document["holds"]) == (3, False)  # 30 steps are too few to tell
    line = process.stderr.splitlines()[-1]
    assert line.startswith("perdure: --require holds is not met: ")
    assert document["groups"][0]["verdict"] in line


def test_a_finished_evaluation_of_a_function_is_not_replaced(evaluated, command):
    folder, _ = evaluated
    again = command("extrapolate", "my_cli_policies:Policies.still", "--env", "Pendulum-v1", *SHORT, cwd=folder)
    assert again.returncode == 2
    assert "another evaluation" in again.stderr


@pytest.mark.parametrize(
    ("word", "named"),
    [
        ("no_such_module:walk", "No module named 'no_such_module'"),
        ("my_cli_policies:walk", "no attribute 'walk'"),
        ("broken_cli_policies:walk", "NameError"),
    ],
)
def test_a_function_that_is_not_there_is_named_in_one_line(evaluated, command, word, named):
    folder, _ = evaluated
    (folder / "broken_cli_policies.py").write_text("walk = undefined\n")
    refused = command("extrapolate", word, "--env", "Pendulum-v1", "--out", "other", cwd=folder)
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    assert word in refused.stderr
    assert named in refused.stderr


def test_a_folder_of_rl_zoo_names_its_environment_and_normalizer(command, tmp_path):
    run = tmp_path / "logs" / "ppo" / "Pendulum-v1_1"
    (run / "Pendulum-v1").mkdir(parents=True)
    (run / "Pendulum-v1.zip").write_bytes((FIXTURES / "ppo.zip").read_bytes())
    (run / "Pendulum-v1" / "vecnormalize.pkl").write_bytes((FIXTURES / "ppo.pkl").read_bytes())
    settings = {"args": {"algo": "ppo", "env": "Pendulum-v1", "env_kwargs": None}, "config": {"normalize": True}}
    for name, values in settings.items():
        (run / "Pendulum-v1" / f"{name}.yml").write_text(yaml.dump(OrderedDict(values)))
    found = command("extrapolate", "logs/ppo/Pendulum-v1_1", *SHORT, "--on", "here", cwd=tmp_path)
    assert found.returncode == 0, found.stderr
    assert "env Pendulum-v1, normalizer logs/ppo/Pendulum-v1_1/Pendulum-v1/vecnormalize.pkl" in found.stderr
    several = command("extrapolate", *[FIXTURES / "ppo.zip"] * 2, "--normalizer", FIXTURES / "ppo.pkl", cwd=tmp_path)
    assert "2 are given" in several.stderr
    given = command(
        *("extrapolate", FIXTURES / "ppo.zip", "--env", "Pendulum-v1", "--normalizer", FIXTURES / "ppo.pkl"),
        *(*SHORT, "--on", "here", "--out", "given"),
        cwd=tmp_path,
    )
    assert given.returncode == 0, given.stderr
    tables = [pl.read_parquet(tmp_path / name / "episodes.parquet").drop("policy", "method") for name in NAMES]
    assert tables[0].equals(tables[1])


NAMES = ("extrapolation", "given")


@pytest.mark.parametrize(
    ("args", "named"),
    [
        ({"env": "Pendulum-v0"}, "--env"),
        ({"env": "some_module:Walk-v0"}, "--modules some_module"),
        ({"env": "Pendulum-v1", "env_kwargs": {"g": 9}}, "env_kwargs g: 9"),
    ],
)
def test_an_environment_that_cannot_be_had_is_named(command, tmp_path, args, named):
    run = tmp_path / "Walk_1"
    (run / "Walk").mkdir(parents=True)
    (run / "best_model.zip").write_bytes((FIXTURES / "ppo.zip").read_bytes())
    (run / "Walk" / "args.yml").write_text(yaml.dump(OrderedDict(args)))
    (run / "Walk" / "config.yml").write_text(yaml.dump(OrderedDict(normalize=False)))
    refused = command("extrapolate", "Walk_1", *SHORT, cwd=tmp_path)
    assert refused.returncode == 2
    assert named in refused.stderr.splitlines()[-1]


def test_a_narrow_terminal_still_lists_tasks(monkeypatch):
    from perdure.cli import show

    monkeypatch.setenv("COLUMNS", "40")
    assert "Hopper-v3" in show.tasks()


def test_list_tasks_is_short_and_complete_for_one_suite(command, tmp_path):
    from perdure.envs import list_tasks

    short = command("list", "tasks", cwd=tmp_path).stdout.splitlines()
    assert len(short) < 60
    assert max(map(len, short)) <= 80
    longest = max({each.suite for each in list_tasks()}, key=lambda suite: len(list_tasks(suite)))
    assert any(f"--suite '{longest}'" in line for line in short)
    listed = command("list", "tasks", "--suite", longest, cwd=tmp_path).stdout.split()
    assert {each.name for each in list_tasks(longest)} <= set(listed)


def test_a_comparison_ends_with_3_unless_b_is_shown_to_be_better(evaluated, command):
    folder, _ = evaluated
    same = ("my_cli_policies:Policies.still", "my_cli_policies:Policies.still")
    flags = ("--env", "Pendulum-v1", "--steps", 30, "--most", 2, "--disturb", "none", "--by", "hours", "--json")
    process = command("compare", *same, *flags, "--require", "better", cwd=folder)
    document = json.loads(process.stdout)
    assert (process.returncode, document["verdict"], document["counts"]) == (3, "cannot tell", [2, 2])
    assert "--require better" in process.stderr.splitlines()[-1]
    assert Path(document["page"]).is_file()
    assert command("compare", *same, *flags, cwd=folder).returncode == 0
