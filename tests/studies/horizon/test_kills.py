"""A study that is killed, or carried out by two commands at once, gives the same files byte for byte."""

import io
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import redirect_stdout
from pathlib import Path

import pytest
from tiny_study import GRID, write_training

from perdure.policy import load_policy
from studies.__main__ import main
from studies.horizon.grid import GRIDS

PROGRAM = Path(__file__).with_name("tiny_study.py")
IN_A_CLONE = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}


def command(out, *options):
    return [sys.executable, str(PROGRAM), "horizon", "--out", str(out), *options]


def run(out, *options):
    """Do in this process what `command` does in another, and return what it prints."""
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(io.StringIO()) as printed:
        patch.setitem(GRIDS, "smoke", GRID)
        main(["horizon", "--out", str(out), *options])
    return printed.getvalue()


def files(out):
    """Bytes of every frozen table, table, figure and policy."""
    return {
        str(path.relative_to(out)): path.read_bytes()
        for path in sorted(Path(out).rglob("*"))
        if path.is_file() and "runs" not in path.relative_to(out).parts
    }


def units(out):
    """How many units of work are finished."""
    return len(list(out.rglob("unit.json")))


def kill_and_go_on(out, kills, seed, *options):
    """Begin a study, kill it at random times, let it finish. One that finishes before its last kill begins again."""
    rng, hits = random.Random(seed), 0
    write_training(out)
    while hits < kills:
        process = subprocess.Popen(
            command(out, *options), env=IN_A_CLONE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        before, end = units(out), time.monotonic() + 120
        while process.poll() is None and units(out) <= before and time.monotonic() < end:
            time.sleep(0.02)
        time.sleep(rng.uniform(0.0, 0.5))
        if process.poll() is None:
            hits += 1
            process.kill()
        elif process.wait() == 0:
            shutil.rmtree(out)
            write_training(out)
        assert process.wait() in (0, -signal.SIGKILL)
    run(out, *options)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The study, carried out without interruption."""
    out = tmp_path_factory.mktemp("whole") / "study"
    write_training(out)
    run(out, "--on", "here")
    return out


@pytest.mark.verify
def test_two_commands_at_once_give_the_same_files(whole, tmp_path):
    out = tmp_path / "study"
    write_training(out)
    options = command(out, "--on", "here")
    both = [
        subprocess.Popen(options, env=IN_A_CLONE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    errors = [each.communicate(timeout=600)[1] for each in both]
    assert [each.returncode for each in both] == [0, 0], errors
    assert files(out) == files(whole)


def test_status_counts_what_is_in_the_store(whole, tmp_path):
    assert re.search(r"evaluate +6 of 6 done, 0 failed \(100% of the work\)", run(whole, "--status"))
    write_training(tmp_path)
    begun = run(tmp_path, "--status")
    assert re.search(r"train segment +4 of 4 done", begun)
    assert re.search(r"evaluate +0 of 6 done, 0 failed \(0% of the work\)", begun)


def test_the_analysis_alone_writes_the_same_files_again_without_the_store(whole, tmp_path):
    for name in whole.glob("*.parquet"):
        shutil.copy(name, tmp_path)
    run(tmp_path, "--analyze-only")
    made = files(tmp_path)
    assert any(name.startswith("figures/figure-") for name in made)
    assert made == {name: content for name, content in files(whole).items() if not name.startswith("policies")}


def test_collected_policies_act_without_a_critic_and_are_collected_once(whole, tmp_path):
    before = files(whole)
    policy = load_policy(whole / "policies" / "InvertedPendulum-v4" / "geometric" / "seed-1.safetensors")
    assert not policy.has_critic
    assert policy.reference is not None
    assert policy.provenance["seed"] == 1
    runs = tmp_path / "runs"
    shutil.copytree(whole / "runs", runs)
    shutil.copytree(runs, runs / "horizon-smoke" / "runs")  # of another study
    shutil.copytree(runs / "InvertedPendulum-v4" / "geometric" / "seed-1", runs / "evaluated" / "groups" / "1f00")
    run(whole, "--collect", str(runs))
    assert files(whole) == before


def test_an_analysis_of_trainings_alone_writes_what_there_is(whole, tmp_path):
    shutil.copytree(whole / "runs" / "InvertedPendulum-v4", tmp_path / "runs" / "InvertedPendulum-v4")
    assert "tables, figures and pages written" in run(tmp_path, "--analyze-only")


@pytest.mark.verify
def test_another_number_of_cores_gives_the_same_files(whole, tmp_path):
    out = tmp_path / "study"
    write_training(out)
    run(out, "--cores", "2")
    assert files(out) == files(whole)


@pytest.mark.verify
def test_twenty_kills(whole, tmp_path):
    out = tmp_path / "study"
    kill_and_go_on(out, 20, 1)
    assert files(out) == files(whole)


@pytest.mark.verify
def test_a_cluster_that_loses_a_node_gives_the_same_files(whole, tmp_path, cluster):
    out = tmp_path / "study"
    write_training(out)
    options = command(out, "--on", f"ray:{cluster.address}")
    process = subprocess.Popen(options, env=IN_A_CLONE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    before = units(out)
    while process.poll() is None and units(out) <= before:
        time.sleep(0.05)
    assert process.poll() is None, process.stderr.read()
    cluster.remove_node(max(cluster.worker_nodes, key=id), allow_graceful=False)
    _, errors = process.communicate(timeout=600)
    assert process.returncode == 0, errors
    assert files(out) == files(whole)
