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


def training(out, *words):
    return command("train", TASK, "--method", METHOD, "--out", out, "--on", "here", *words)


def test_it_trains_is_killed_resumes_and_is_judged(installed, tmp_path):
    folder = Path(TASK, METHOD, "seed-0")
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
    assert (group["policy"], group["episodes"]) == (METHOD, 3)
    lengths = pl.read_parquet(policy.with_name("episodes.parquet")).group_by("step").agg(pl.col("length").mean())
    first, *_, last = lengths.sort("step")["length"]
    assert last > 5 * first, "it learns to balance"
    assert f"--method {METHOD}" in load_policy(policy).provenance["command"]
    assert load_policy(policy).provenance["config"]["algorithm"] == METHOD


def test_its_settings_are_flags_and_its_name_is_offered(installed, tmp_path):
    flags = training(tmp_path, f"--{METHOD}.total-steps", 3200, f"--{METHOD}.sigma", 0.1, "--name", "small")
    subprocess.run(flags, env=installed, check=True, capture_output=True)
    provenance = load_policy(tmp_path / TASK / "small" / "seed-0" / "policy.safetensors").provenance
    assert (provenance["config"]["sigma"], provenance["config"]["total_steps"]) == (0.1, 3200)
    assert f"--{METHOD}.sigma 0.1" in provenance["command"]
    listed = subprocess.run(command("list", "methods"), env=installed, check=True, capture_output=True, text=True)
    assert METHOD in listed.stdout
    near = subprocess.run(
        command("train", TASK, "--method", "evolution-strategy"), env=installed, capture_output=True, text=True
    )
    assert METHOD in near.stderr
    absent = subprocess.run(training(tmp_path / "absent"), capture_output=True, text=True)
    assert absent.returncode == 2, "control: without the package there is no such method"
