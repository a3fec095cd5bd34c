"""The runs of the cure are those that its registered text names, and finished ones are collected."""

import json
from dataclasses import replace

import polars as pl
import pytest

from perdure.cli import run as run_command
from perdure.learn import TrainRun, method_config
from perdure.learn.provenance import command
from perdure.runs import Store, attempt
from studies.cure import grid, study
from studies.disturbance.grid import Condition


def test_the_trainings_are_the_registered_ones():
    runs = {(arm.name, task): arm.run(task) for arm, task in grid.cells([1, 2, 3])}
    long = runs["continued-long-noise", "HalfCheetah-v3"].config
    assert (long.protocol.gamma, long.protocol.normalizer_gamma, long.log_std_init) == (0.999, 0.98, -1.5)
    assert (long.total_steps, long.learning_rate_decay, long.hidden_sizes) == (300_000, "none", (256, 256))
    hopper = runs["continued-geometric-noise", "Hopper-v3"]
    assert (hopper.config.protocol.gamma, hopper.config.log_std_init, hopper.seeds) == (1.0, -1.0, tuple(range(13, 20)))
    assert hopper.config.learning_rate_decay == "linear"
    assert hopper.start == grid.POLICIES / "Hopper-v3" / "ppo@cleanrl"
    assert runs["continued-noise", "HalfCheetah-v3"].config.protocol.gamma == 0.98
    assert runs["continued-long", "Walker2d-v3"].disturb == ()
    whole = runs["geometric-noise-1.3M", "Walker2d-v3"]
    assert (whole.config.total_steps, whole.start, whole.disturb) == (1_300_000, None, ("action_noise:0.1",))
    ant = runs["ppo-quiet", "Ant-v3"].config
    assert (ant.total_steps, ant.log_std_init, ant.learning_rate_decay) == (3_000_000, -1.0, "linear")
    assert len(study.plan("thesis", [1, 2, 3], study.Path("runs"))) == 5 * 3 * 7 * 4 + 2 * 10 * 2


def test_a_run_is_repeated_by_the_command_in_its_policy(monkeypatch):
    """The command trains an equal run, here of one seed."""
    found = []
    monkeypatch.setattr("perdure.learn.run.train", lambda run, *_, **options: found.append(run) or [])
    arm = grid.ARMS[3]
    run = arm.run("Hopper-v3")
    from perdure.envs import task_spec

    run_command(command(run, task_spec("Hopper-v3"), 14).split()[1:])
    assert found == [replace(run, seeds=(14,))]


@pytest.fixture
def tiny(monkeypatch, tmp_path):
    """A study of one arm on a small task, its only training finished."""
    config = replace(method_config("ppo", "InvertedPendulum-v4", 4), total_steps=64, n_steps=64, hidden_sizes=(4,))
    condition = Condition("standard-1", ("action_noise:0.1",), 100)
    arm = grid.Arm("tiny", "tiny", "ppo", 1, ("InvertedPendulum-v4",), (3,), base=None, conditions=(condition,))
    monkeypatch.setattr(grid.Arm, "run", lambda self, task: TrainRun(task, self.name, config, self.seeds))
    monkeypatch.setattr("studies.cure.grid.ARMS", (arm,))
    return arm


def test_finished_runs_are_collected_once(tiny, tmp_path):
    store = Store(tmp_path / "runs")
    units = study.plan("thesis", [1], tmp_path / "runs")
    for unit in units:
        attempt(store.root, unit)
    (policy,) = study.collect(store, tmp_path)
    assert policy.name == "seed-3.safetensors"
    study.collect(store, tmp_path)
    rows = pl.read_parquet(tmp_path / study.EPISODES)
    assert (rows["arm"].unique().to_list(), rows["train_seed"].unique().to_list(), len(rows)) == (["tiny"], [3], 5)
    assert json.loads(json.dumps(rows.select("eval_seed").to_series().to_list())) == [3000, 3001, 3002, 3003, 3004]
