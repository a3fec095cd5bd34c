"""An algorithm of another package trains, is killed, resumes, and leaves a policy that is judged."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import polars as pl
import pytest

from perdure.errors import PerdureError
from perdure.learn.algorithm import algorithm_of
from perdure.policy import load_policy

TASK = "InvertedPendulum-v4"
METHOD = "evolution-strategies"
SEED = Path(TASK, "wide", "seed-0")
MODULE = Path(__file__).parent / "own" / "evolution_strategies.py"


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The environment of a process in which the package is installed, as pip would leave it."""
    site = tmp_path_factory.mktemp("site")
    shutil.copy(MODULE, site)
    record = site / "evolution_strategies-1.0.dist-info"
    record.mkdir()
    (record / "METADATA").write_text("Metadata-Version: 2.1\nName: evolution-strategies\nVersion: 1.0\n")
    (record / "entry_points.txt").write_text("[perdure.plugins]\nevolution-strategies = evolution_strategies\n")
    paths = [str(site), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


def command(*words):
    return [sys.executable, "-m", "perdure", *map(str, words)]


def training(out):
    flags = ["--out", out, "--on", "here", f"--{METHOD}.sigma", 0.6, "--name", "wide"]
    return command("train", TASK, "--method", METHOD, *flags)


@pytest.fixture(scope="module")
def trained(installed, tmp_path_factory):
    """The folder of a seed that was trained without interruption."""
    out = tmp_path_factory.mktemp("whole")
    subprocess.run(training(out), env=installed, check=True, capture_output=True)
    return out / SEED


@pytest.mark.verify
def test_it_is_killed_and_resumes(installed, trained, tmp_path):
    killed = subprocess.Popen(training(tmp_path), env=installed, stderr=subprocess.DEVNULL)
    while killed.poll() is None and not list(tmp_path.rglob("checkpoint.safetensors")):
        time.sleep(0.01)
    killed.send_signal(signal.SIGKILL)
    assert killed.wait() == -signal.SIGKILL, "it was to be killed before its end"
    subprocess.run(training(tmp_path), env=installed, check=True, capture_output=True)
    for name in ("policy.safetensors", "episodes.parquet", "iterations.parquet"):
        assert (tmp_path / SEED / name).read_bytes() == (trained / name).read_bytes()


@pytest.mark.verify
def test_it_learns_and_is_judged(installed, trained, tmp_path):
    policy = trained / "policy.safetensors"
    judged = command("extrapolate", policy, "--steps", 1000, "--disturb", "none", "--json", "--out", tmp_path / "out")
    done = subprocess.run(judged, env=installed, check=True, capture_output=True, text=True)
    (group,) = json.loads(done.stdout)["groups"]
    assert (group["policy"], group["episodes"]) == ("wide", 3)
    lengths = pl.read_parquet(policy.with_name("episodes.parquet")).group_by("step").agg(pl.col("length").mean())
    first, *_, last = lengths.sort("step")["length"]
    assert last > 5 * first, "it learns to balance"
    provenance = load_policy(policy).provenance
    assert f"--method {METHOD} --name wide --seeds 0 --{METHOD}.sigma 0.6" in provenance["command"]
    assert (provenance["config"]["algorithm"], provenance["config"]["sigma"]) == (METHOD, 0.6)


def test_its_method_is_listed(installed):
    listed = subprocess.run(command("list", "methods"), env=installed, check=True, capture_output=True, text=True)
    assert METHOD in listed.stdout
    with pytest.raises(PerdureError, match="method"):
        algorithm_of(METHOD)  # in this process the package is not installed
