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


def test_it_trains_is_killed_resumes_and_is_judged(installed, tmp_path):
    folder = Path(TASK, "wide", "seed-0")
    subprocess.run(training(tmp_path / "whole"), env=installed, check=True, capture_output=True)
    killed = subprocess.Popen(training(tmp_path / "killed"), env=installed, stderr=subprocess.DEVNULL)
    while killed.poll() is None and not list((tmp_path / "killed").rglob("checkpoint.safetensors")):
        time.sleep(0.01)
    killed.send_signal(signal.SIGKILL)
    assert killed.wait() == -signal.SIGKILL, "it was to be killed before its end"
    subprocess.run(training(tmp_path / "killed"), env=installed, check=True, capture_output=True)
    for name in ("policy.safetensors", "episodes.parquet", "iterations.parquet"):
        whole = (tmp_path / "whole" / folder / name).read_bytes()
        assert (tmp_path / "killed" / folder / name).read_bytes() == whole

    policy = tmp_path / "whole" / folder / "policy.safetensors"
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
