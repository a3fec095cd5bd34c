"""A disturbance of a separate package works from the command line, without a changed file of ours."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = """
from perdure.disturbances import Effect


class ActionGain(Effect):
    name = "gain"
    words = "each action, times `level`"
    unit = "factor"
    example = 0.8
    neutral = 1.0

    def on_action(self, actions, lanes, elapsed):
        return self.level * actions
"""


@pytest.fixture
def run(tmp_path):
    """Run perdure beside an installed package that declares an entry point."""
    site = tmp_path / "site"
    (site / "gains-1.0.dist-info").mkdir(parents=True)
    (site / "my_gains.py").write_text(PACKAGE)
    (site / "gains-1.0.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: gains\nVersion: 1.0\n")
    (site / "gains-1.0.dist-info" / "entry_points.txt").write_text("[perdure.plugins]\ngains = my_gains\n")
    path = os.pathsep.join([str(site), *filter(None, [os.environ.get("PYTHONPATH")])])

    def made(*words):
        command = [sys.executable, "-m", "perdure", *map(str, words)]
        environment = {**os.environ, "PYTHONPATH": path, "COLUMNS": "200"}
        done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=tmp_path, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return made


def test_it_is_listed_and_explained(run):
    assert "each action, times `level`" in run("list", "disturbances")
    assert "gain:0.8 (factor)" in " ".join(run("extrapolate", "--help").replace("│", " ").split())


def test_it_disturbs_an_evaluation(run, tmp_path):
    flags = ("--clocks", "constant:500", "--eval-seeds", 2, "--steps", 200, "--on", "local", "--out", "out", "--json")
    found = json.loads(run("extrapolate", "Hopper-v3/geometric", *flags, "--disturb", "gain:0,1@100"))
    returns = {group["disturbance"]: group["mean_return"]["estimate"] for group in found["groups"]}
    assert list(returns) == ["gain:0@100", "gain:1@100"]
    assert returns["gain:1@100"] > 1.2 * returns["gain:0@100"]  # a robot that stops acting falls
    assert "gain:0@100" in Path(tmp_path, "out", "report.html").read_text()


def test_it_disturbs_training(run, tmp_path):
    small = ("--ppo.total-steps", 64, "--ppo.n-steps", 32, "--ppo.batch-size", 32, "--ppo.n-epochs", 1)
    preset = ("--method", "ppo", "--preset", "cleanrl", "--on", "here", "--out", "runs")
    run("train", "InvertedPendulum-v4", *preset, *small, "--disturb", "gain:0.5")
    (policy,) = Path(tmp_path, "runs").rglob("policy.safetensors")
    assert policy.parent.parent.name == "ppo+gain-0.5@cleanrl"
    assert "--disturb gain:0.5" in run("inspect", policy)
