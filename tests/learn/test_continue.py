"""Training that continues a policy begins with what the policy does, and leaves a policy of its own."""

from dataclasses import replace
from shlex import split

import numpy as np
import polars as pl
import pytest

from perdure.cli import run as run_command
from perdure.errors import PerdureError
from perdure.horizon import Constant, Geometric, Linear
from perdure.learn import TrainRun, method_config, train
from perdure.learn.run import Segments
from perdure.policy import load_policy, save_policy

TASK = "InvertedPendulum-v4"
TINY = {"total_steps": 256, "n_steps": 64, "batch_size": 64, "hidden_sizes": (8,), "n_epochs": 1, "segment_steps": 128}
PPO = replace(method_config("ppo", TASK, 4), **TINY)
GEOMETRIC = replace(method_config("geometric", TASK, 4), **TINY)
STATES = np.random.default_rng(0).normal(size=(5, 4))
ELAPSED = np.arange(5.0)


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    """A folder with a policy for each of two seeds."""
    out = tmp_path_factory.mktemp("base")
    train(TrainRun(TASK, "ppo", PPO, (0, 1)), out, cores=1)
    return out / TASK / "ppo"


def first_policy(config, policy):
    segments = Segments(TASK, config, 1)
    return segments.algorithm.policy(segments.first(7, policy).learner)


def test_before_its_first_step_it_acts_as_the_policy_that_it_continues(base):
    policy = load_policy(base / "seed-0/policy.safetensors")
    begun = first_policy(PPO, policy)
    np.testing.assert_allclose(begun.act(STATES, ELAPSED), policy.act(STATES, ELAPSED), rtol=1e-6)
    assert not np.allclose(first_policy(PPO, None).act(STATES, ELAPSED), policy.act(STATES, ELAPSED)), "control"


@pytest.mark.parametrize("conditioning", ["concatenate", "film", "critic"])
def test_an_added_time_to_go_has_no_effect_at_first(base, conditioning):
    policy = load_policy(base / "seed-0/policy.safetensors")
    begun = first_policy(replace(GEOMETRIC, conditioning=conditioning), policy)
    assert begun.protocol.embedding == Geometric(5)
    for steps in (0, 3, 500):
        acted = begun.act(STATES, ELAPSED, Constant(steps))
        np.testing.assert_allclose(acted, policy.act(STATES, ELAPSED), rtol=1e-6)


@pytest.mark.verify
def test_a_time_to_go_in_the_critic_only_never_reaches_the_actions():
    acts = {}
    for conditioning in ("critic", "concatenate"):
        segments = Segments(TASK, replace(GEOMETRIC, conditioning=conditioning), 1)
        learner = segments.run(segments.first(7), lambda *_: None).learner
        policy = segments.algorithm.policy(learner)
        acts[conditioning] = [policy.act(STATES, ELAPSED, Constant(steps)) for steps in (0, 500)]
        values = [policy.scaled_value(STATES, ELAPSED, ELAPSED + steps) for steps in (1, 500)]
        assert not np.allclose(*values), "the critic sees it"
    np.testing.assert_array_equal(*acts["critic"])
    assert not np.allclose(*acts["concatenate"]), "control"


def test_the_critic_is_new_and_the_normalizer_keeps_moving(base):
    policy = load_policy(base / "seed-0/policy.safetensors")
    segments = Segments(TASK, PPO, 1)
    begun = segments.first(7, policy)
    statistics = begun.learner.statistics.observations
    assert float(statistics.count) == 256.0
    np.testing.assert_allclose(statistics.mean, policy.normalizer.mean)
    critic = np.asarray(begun.learner.params["value.0.weight"])
    np.testing.assert_array_equal(critic, np.asarray(segments.first(7).learner.params["value.0.weight"]))
    assert not np.allclose(critic, policy.weights["value.0.weight"])
    after = segments.run(begun, lambda *_: None)
    assert float(after.learner.statistics.observations.count) > 256.0


def test_each_seed_continues_its_own_policy_and_says_so(base, tmp_path):
    start = {"method": "longer", "config": PPO, "base_method": "ppo", "start": base}
    paths = train(TrainRun(TASK, seeds=(0, 1), **start), tmp_path / "both", cores=1)
    (alone,) = train(TrainRun(TASK, seeds=(1,), **start), tmp_path / "alone", cores=1)
    assert paths[1].read_bytes() == alone.read_bytes()
    policy = load_policy(paths[1])
    assert policy.provenance["from"]["steps"] == 256
    assert f"--from {base}" in policy.provenance["command"]
    (again,) = train(TrainRun(TASK, "again", PPO, (1,), base_method="ppo", start=paths[1]), tmp_path / "again", cores=1)
    assert load_policy(again).provenance["from"]["steps"] == 512


def test_another_policy_in_the_file_is_another_run(base, tmp_path):
    other = base / "seed-1/policy.safetensors"
    one = TrainRun(TASK, "longer", PPO, (0,), start=base / "seed-0/policy.safetensors").identity(0)
    two = TrainRun(TASK, "longer", PPO, (0,), start=other).identity(0)
    copied = tmp_path / "copied.safetensors"
    copied.write_bytes(other.read_bytes())
    assert one != two
    assert TrainRun(TASK, "longer", PPO, (0,), start=copied).identity(0) == two, "the place of the file is not part"


def test_the_recorded_command_continues_the_same_policy(base, tmp_path):
    flags = f"--ppo.total-steps 256 --ppo.n-steps 64 --ppo.n-epochs 1 --out {tmp_path / 'first'} --on here".split()
    run_command(["train", TASK, "--method", "geometric", "--from", str(base), "--seeds", "1", *flags])
    (path,) = (tmp_path / "first").rglob("policy.safetensors")
    assert path.parent.parent.name == "geometric+continued"
    run_command(
        [*split(load_policy(path).provenance["command"])[1:], "--out", str(tmp_path / "second"), "--on", "here"]
    )
    (again,) = (tmp_path / "second").rglob("policy.safetensors")
    assert again.read_bytes() == path.read_bytes()
    rows = pl.read_parquet(path.parent / "iterations.parquet")
    assert rows["std"][0] < 0.5, "less noise than at the start of a training"


def test_what_cannot_be_continued_is_refused_at_the_door(base, tmp_path):
    policy = load_policy(base / "seed-0/policy.safetensors")
    with pytest.raises(PerdureError, match="seed-5"):
        TrainRun(TASK, "longer", PPO, (5,), start=base)
    with pytest.raises(PerdureError, match="no/such"):
        TrainRun(TASK, "longer", PPO, start=tmp_path / "no/such.safetensors")
    with pytest.raises(PerdureError, match="hidden_sizes"):
        first_policy(replace(PPO, hidden_sizes=(4,)), policy)
    with pytest.raises(PerdureError, match="relu"):
        first_policy(replace(PPO, activation="relu"), policy)
    timed = first_policy(GEOMETRIC, policy)
    with pytest.raises(PerdureError, match="time-to-go"):
        first_policy(PPO, timed)
    with pytest.raises(PerdureError, match="time-to-go"):
        first_policy(replace(PPO, protocol=replace(GEOMETRIC.protocol, embedding=Linear())), timed)
    elsewhere = replace(policy, task=replace(policy.task, action_high=(9.0,)))
    with pytest.raises(PerdureError, match="actions"):
        first_policy(PPO, load_policy(save_policy(elsewhere, tmp_path / "elsewhere.safetensors")))
