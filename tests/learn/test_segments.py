"""A run is one run: killed or not, alone or beside others, on one thread or two, it leaves the same bytes."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import jax
import numpy as np
import polars as pl
import pytest
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

from perdure.errors import OtherSourceWarning, PerdureError, PerdureWarning
from perdure.horizon import Geometric, HorizonProtocol, Uniform
from perdure.learn import PPOConfig, TrainRun, on_report, train
from perdure.learn.checkpoint import load_checkpoint, save_checkpoint
from perdure.learn.progress import tensorboard
from perdure.learn.run import Segments, kept_steps
from perdure.policy import load_policy

TASK = "InvertedPendulum-v4"
NOISES = ("action_delay:1", "action_noise:0.5", "observation_noise:0.2")
SEGMENT = 192
TINY = PPOConfig(
    protocol=HorizonProtocol(Geometric(3), Uniform(5, 20), "terminated", gamma=1.0, normalizer_gamma=1.0),
    n_envs=2,
    n_steps=32,
    batch_size=32,
    n_epochs=2,
    hidden_sizes=(8,),
    learning_rate=3e-3,
    segment_steps=SEGMENT,
    total_steps=2 * SEGMENT,
)
LEFT_BEHIND = ("policy.safetensors", "episodes.parquet", "iterations.parquet")


class Killed(BaseException):
    """Stands in for a signal: nothing in the library may catch it."""


def run(*seeds):
    return TrainRun(TASK, "geometric", TINY, seeds)


def files(store, seed):
    folder = Path(store) / run(seed).key(seed)
    return {name: (folder / name).read_bytes() for name in LEFT_BEHIND}


def die_at(step, *seeds):
    def told(report):
        if report.step >= step:
            raise Killed

    return on_report(run(*seeds), told)


def test_discrete_actions_are_refused_by_name():
    with pytest.raises(PerdureError, match="gymnasium:CartPole-v1: PPO here needs continuous actions"):
        Segments("gymnasium:CartPole-v1", TINY, 1)


@pytest.fixture(scope="module")
def solo(tmp_path_factory):
    """Seed 1 trained alone on one thread without interruption."""
    store = tmp_path_factory.mktemp("solo")
    train(run(1), store, cores=1)
    return store


def test_a_run_leaves_curves_of_every_iteration_and_of_episodes_inside_the_horizon_law(solo):
    folder = solo / run(1).key(1)
    assert pl.read_parquet(folder / "iterations.parquet")["step"].to_list() == [64, 128, 192, 256, 320, 384]
    lengths = pl.read_parquet(folder / "episodes.parquet")["length"]
    assert len(lengths) > 10
    assert lengths.max() <= 20


def test_a_run_killed_in_the_middle_of_a_segment_and_started_again_leaves_the_same_bytes(solo, tmp_path):
    with pytest.raises(Killed):
        train(run(1), tmp_path, cores=1, observe=die_at(SEGMENT + 64, 1))
    assert not (tmp_path / run(1).key(1)).exists(), "an unfinished run must not look finished"
    assert kept_steps(run(1), tmp_path) == {1: SEGMENT + 64}
    seen = []
    train(run(1), tmp_path, cores=1, observe=on_report(run(1), lambda report: seen.append(report.step)))
    assert seen[0] == SEGMENT + 128, "the run must go on from its last checkpoint, not from the segment's beginning"
    assert files(tmp_path, 1) == files(solo, 1)
    assert kept_steps(run(1), tmp_path) == {}, "a finished run has no checkpoint"


def test_a_report_has_the_reward_of_a_step_and_curves_have_the_losses(tmp_path):
    """In this task every step pays 1, however long the episodes are."""
    pytest.importorskip("tensorboardX")
    one = replace(run(1), config=replace(TINY, total_steps=SEGMENT))
    reports = []
    with tensorboard(tmp_path / "curves") as watch:
        observe = on_report(one, lambda report: (reports.append(report), watch(report)))
        train(one, tmp_path / "runs", cores=1, observe=observe)
    assert reports[-1].reward_per_step == 1.0
    assert reports[-1].mean_return == reports[-1].mean_length > 1
    (events,) = (tmp_path / "curves").iterdir()
    curves = ("reward_per_step", "mean_length", "approx_kl", "value_loss", "explained_variance")
    assert all(f"train/seed-1/{name}".encode() in events.read_bytes() for name in curves)


def weights(path):
    return {name: array for name, array in load_file(path).items() if name.startswith("policy.")}


def same(one, other):
    return all((one[name] == other[name]).all() for name in one)


@pytest.mark.parametrize(
    ("task", "disturb"),
    [(TASK, NOISES), ("gymnasium:InvertedPendulum-v5", ()), ("gymnasium:InvertedPendulum-v5", NOISES)],
)
def test_a_run_killed_in_its_first_segment_keeps_its_iterations_and_leaves_the_same_bytes(
    solo, tmp_path, monkeypatch, task, disturb
):
    monkeypatch.setattr("perdure.learn.partial.SECONDS", 0.0)
    monkeypatch.setattr("perdure.learn.partial.LARGEST_SHARE", math.inf)
    one = replace(run(1), task=task, disturb=disturb, config=replace(TINY, total_steps=SEGMENT))
    (whole,) = train(one, tmp_path / "whole", cores=1)
    seen = []

    def die(report):
        seen.append(report.step)
        if report.step == 2 * 64:
            raise Killed

    with pytest.raises(Killed):
        train(one, tmp_path / "killed", cores=1, observe=on_report(one, die))
    assert kept_steps(one, tmp_path / "killed") == {1: 2 * 64}
    (killed,) = train(one, tmp_path / "killed", cores=1, observe=on_report(one, die))
    assert seen == [64, 128, 192]
    for name in LEFT_BEHIND:
        assert killed.with_name(name).read_bytes() == whole.with_name(name).read_bytes()
    assert not killed.with_name("partial.safetensors").exists()
    assert load_policy(whole).provenance.get("disturb", []) == list(disturb)
    assert not same(weights(solo / run(1).key(1) / "policy.safetensors"), weights(whole))


def test_noise_of_level_0_trains_what_the_calm_run_trains(solo, tmp_path):
    """Though the world is stepped from Python and not by XLA. It is another run all the same."""
    (path,) = train(replace(run(1), disturb=("action_noise:0",)), tmp_path, cores=1)
    assert same(weights(solo / run(1).key(1) / "policy.safetensors"), weights(path))
    with pytest.raises(PerdureError, match="disturb"):
        train(run(1), tmp_path)


def test_pushes_are_trained_in_gymnasiums_copy_for_a_policy_of_the_task_itself():
    segments = Segments("Hopper-v3", replace(TINY, n_envs=1), 1, ("push:0.5",))
    assert segments.spec.name == "Hopper-v3"
    assert segments.engine.startswith("Gymnasium ")


def test_disturbances_that_the_task_cannot_have_are_refused_before_anything_is_trained():
    for disturb, words in {
        ("push:1",): "Hopper-v3",
        ("push:1", "push:2"): "twice",
        ("punch:1",): "did you mean",
    }.items():
        with pytest.raises(PerdureError, match=words):
            TrainRun(TASK, "ppo", TINY, disturb=disturb)


@pytest.mark.parametrize(
    ("on", "cores"),
    [("here", 2), *(pytest.param("local", cores, marks=pytest.mark.verify) for cores in (1, 2))],
)
def test_a_seed_beside_another_on_two_threads_equals_the_seed_alone_on_one(solo, tmp_path, on, cores):
    told = []
    train(run(0, 1), tmp_path, cores=cores, on=on, observe=on_report(run(0, 1), told.append))
    assert {report.seed for report in told} == {0, 1}
    shares = [report.share for report in told]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert files(tmp_path, 1) == files(solo, 1)
    policies = {files(tmp_path, seed)["policy.safetensors"] for seed in (0, 1)}
    assert len(policies) == 2, "seeds must differ, or their equality proves nothing"


def test_a_process_that_fails_says_why_and_leaves_no_run(tmp_path):
    import gymnasium

    gymnasium.register("OnlyHere-v0", "gymnasium.envs.classic_control.pendulum:PendulumEnv", max_episode_steps=50)
    only_here = TrainRun("gymnasium:OnlyHere-v0", "geometric", TINY, (0,))
    with pytest.raises(PerdureError, match="OnlyHere"):
        train(only_here, tmp_path, on="local")
    assert not (tmp_path / only_here.key(0)).exists()


def test_a_finished_run_is_not_touched_again_whatever_code_made_it(solo, monkeypatch):
    before = (solo / run(1).key(1) / "policy.safetensors").stat()
    with monkeypatch.context() as patch:
        patch.setattr("perdure.runs.store.source_digest", lambda: "another")
        with pytest.warns(OtherSourceWarning, match="1 of 1"):
            train(run(1), solo, cores=1, observe=lambda status: pytest.fail("a finished run must not be trained"))
    after = (solo / run(1).key(1) / "policy.safetensors").stat()
    assert (after.st_mtime_ns, after.st_ino) == (before.st_mtime_ns, before.st_ino)


def test_other_settings_under_the_same_name_are_refused(solo):
    other = TrainRun(TASK, "geometric", replace(TINY, gae_lambda=0.5), (1,))
    with pytest.raises(PerdureError, match="gae_lambda"):
        train(other, solo)


def bits(state):
    arrays = [state.learner, state.episodes, state.iterations]
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(arrays)]
    return (state.seed, state.segment), [(leaf.dtype, leaf.shape, leaf.tobytes()) for leaf in leaves]


def copy(state):
    """The runner takes over the arrays it is given."""
    return replace(state, learner=jax.tree.map(lambda x: x.copy(), state.learner))


@pytest.fixture(scope="module")
def runner():
    """What learns is compiled once for all tests of checkpoint files."""
    return Segments(TASK, replace(TINY, total_steps=3 * SEGMENT), threads=1)


@pytest.fixture(scope="module")
def chain(runner):
    """The states after 0, 1, 2, 3 segments of a run that never left memory."""
    states = [runner.first(5)]
    for _ in range(3):
        states.append(runner.run(copy(states[-1]), lambda step, facts: None))
    return states


class TestCheckpointFiles:
    def test_a_checkpoint_holds_the_whole_state_bit_for_bit(self, chain, tmp_path):
        for state in chain:
            save_checkpoint(state, tmp_path / "c")
            assert bits(load_checkpoint(tmp_path / "c", chain[0])) == bits(state)

    def test_a_run_stopped_after_each_segment_is_the_run_that_was_not(self, runner, chain, tmp_path):
        for before, expected in pairwise(chain[1:]):
            save_checkpoint(before, tmp_path / "c")
            state = runner.run(load_checkpoint(tmp_path / "c", chain[0]), lambda step, facts: None)
            assert bits(state) == bits(expected)

    @pytest.fixture
    def partial(self, runner, chain, tmp_path):
        """What a run leaves that is killed after the first iteration of its first segment."""

        def die(step, facts):
            raise Killed

        with pytest.raises(Killed):
            runner.run(copy(chain[0]), die, tmp_path / "p")
        return tmp_path / "p"

    def test_a_partial_checkpoint_that_was_not_removed_means_nothing_in_the_next_segment(self, runner, chain, partial):
        assert bits(runner.run(copy(chain[1]), lambda step, facts: None, partial)) == bits(chain[2])

    def test_environments_that_do_not_repeat_what_they_did_are_trained_again(self, runner, chain, partial):
        """As those do that draw random numbers of their own: here the recorded actions are others."""
        arrays = load_file(partial)
        with safe_open(partial, framework="numpy") as file:
            header = file.metadata()
        save_file({**arrays, "sent/actions": -arrays["sent/actions"]}, partial, header)
        with pytest.warns(PerdureWarning, match="again from step 0"):
            state = runner.run(copy(chain[0]), lambda step, facts: None, partial)
        assert bits(state) == bits(chain[1])

    def test_segments_differ_so_that_equal_files_prove_something(self, chain):
        weights = [np.asarray(state.learner.params["policy.0.weight"]) for state in chain]
        assert all(np.abs(a - b).max() > 1e-4 for a, b in pairwise(weights))

    def test_a_damaged_checkpoint_is_refused_by_name(self, chain, tmp_path):
        path = tmp_path / "checkpoint.safetensors"
        save_checkpoint(chain[1], path)
        whole = path.read_bytes()
        for length in (0, 4, 8, 100, len(whole) // 2, len(whole) - 1):
            path.write_bytes(whole[:length])
            with pytest.raises(PerdureError, match=r"checkpoint\.safetensors"):
                load_checkpoint(path, chain[0])

    @pytest.mark.parametrize(
        "header",
        [
            "[" * 100_000,
            "null",
            '{"version": "2", "seed": 0}',
            '{"version": "2", "seed": null, "segment": 1}',
            '{"version": "2", "seed": 0, "segment": -1}',
            '{"version": "2", "seed": 0, "segment": "1"}',
        ],
        ids=lambda text: text[:50],
    )
    def test_a_checkpoint_with_another_header_is_refused_by_name(self, chain, tmp_path, header):
        path = tmp_path / "checkpoint.safetensors"
        save_checkpoint(chain[1], path)
        save_file(load_file(path), path, {"perdure.checkpoint": header})
        with pytest.raises(PerdureError, match=r"checkpoint\.safetensors"):
            load_checkpoint(path, chain[0])

    @pytest.mark.parametrize("change", [lambda a: a[..., :1], lambda a: a.astype(np.float16)], ids=["shape", "type"])
    def test_a_checkpoint_with_another_array_is_refused_by_name(self, chain, tmp_path, change):
        path = tmp_path / "checkpoint.safetensors"
        save_checkpoint(chain[1], path)
        with safe_open(path, framework="numpy") as file:
            header = file.metadata()
        arrays = load_file(path)
        name = "learner/params/policy.0.weight"
        arrays[name] = np.ascontiguousarray(change(arrays[name]))
        save_file(arrays, path, header)
        with pytest.raises(PerdureError, match=name):
            load_checkpoint(path, chain[0])

    def test_a_checkpoint_of_another_seed_is_refused(self, chain, tmp_path):
        path = tmp_path / "checkpoint.safetensors"
        save_checkpoint(chain[1], path)
        other = replace(chain[0], seed=chain[0].seed + 1)
        with pytest.raises(PerdureError, match=f"of seed {chain[0].seed}, not of {other.seed}"):
            load_checkpoint(path, other)


def test_an_attempt_interrupted_after_its_last_file_is_not_trained_again(tmp_path, monkeypatch):
    """The store was about to move the finished folder when the process was killed."""
    from perdure.runs import store

    def killed(folder):
        raise Killed

    run = TrainRun(TASK, "ppo", TINY, (0,))
    monkeypatch.setattr(store, "_sync_tree", killed)
    with pytest.raises(Killed):
        train(run, tmp_path)
    monkeypatch.undo()
    monkeypatch.setattr(Segments, "run", lambda *_: pytest.fail("a segment was trained again"))
    (path,) = train(run, tmp_path)
    assert path.is_file()
    assert {each.name for each in path.parent.iterdir()} >= set(LEFT_BEHIND)
    assert "checkpoint.safetensors" not in {each.name for each in path.parent.iterdir()}


def test_training_that_diverges_is_named_with_its_iteration(tmp_path):
    with pytest.raises(
        PerdureError, match=r"training diverged in iteration \d+: losses are not finite \(learning rate 1e"
    ):
        train(TrainRun(TASK, "ppo", replace(TINY, learning_rate=1e38), (0,)), tmp_path)


@pytest.mark.parametrize("seeds", [(-1,), (2**31,), (0, 0)])
def test_seeds_out_of_range_are_refused_before_anything_is_trained(seeds):
    with pytest.raises(PerdureError, match="seeds must be different numbers from 0 to 2,147,483,647"):
        TrainRun(TASK, "ppo", TINY, seeds)


SCRIPT = """
import sys
from perdure.learn import PPOConfig, TrainRun, on_report, train
from perdure.horizon import HorizonProtocol, Uniform
protocol = HorizonProtocol(None, Uniform(20, 60), "truncated", gamma=0.99, normalizer_gamma=0.99)
config = PPOConfig(protocol=protocol, n_steps=256, batch_size=64, hidden_sizes=(16,),
                   segment_steps=1024, total_steps=4096)
run = TrainRun("Hopper-v3", "ppo", config, (0, 1))
train(
    run, sys.argv[1], on=sys.argv[2], observe=on_report(run, lambda report: print(report.step, flush=True))
)
"""


@pytest.mark.verify
@pytest.mark.parametrize("on", ["here", "local"])
def test_kill_minus_9_in_the_middle_of_a_segment_then_the_same_command_leaves_the_same_bytes(tmp_path, on):
    command = [sys.executable, "-c", SCRIPT]
    subprocess.run([*command, str(tmp_path / "whole"), "here"], check=True, stdout=subprocess.DEVNULL)
    for step in (512, 2560):
        process = subprocess.Popen([*command, str(tmp_path / "killed"), on], stdout=subprocess.PIPE, text=True)
        for line in process.stdout:
            if int(line) >= step:
                os.kill(process.pid, signal.SIGKILL)
                break
        process.stdout.close()
        assert process.wait() == -signal.SIGKILL
    subprocess.run([*command, str(tmp_path / "killed"), on], check=True, stdout=subprocess.DEVNULL)
    for seed in (0, 1):
        whole, killed = (tmp_path / name / f"Hopper-v3/ppo@cleanrl/seed-{seed}" for name in ("whole", "killed"))
        for name in LEFT_BEHIND:
            assert (whole / name).read_bytes() == (killed / name).read_bytes(), (seed, name)
