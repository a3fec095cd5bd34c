"""The command in a policy file trains the same settings under the same name, or is left out."""

from dataclasses import replace
from shlex import split

import pytest

from perdure.cli import run as run_command
from perdure.envs import make_world
from perdure.errors import PerdureError
from perdure.horizon import Geometric, Uniform
from perdure.learn import TrainRun, method_config, train
from perdure.learn.provenance import command
from perdure.policy import load_policy

TASK = "InvertedPendulum-v4"
PPO, GEOMETRIC = (method_config(method, TASK, 4) for method in ("ppo", "geometric"))
TINY = {"total_steps": 64, "n_steps": 64, "batch_size": 64, "hidden_sizes": (4,), "n_epochs": 1}


@pytest.fixture(scope="module")
def spec():
    world = make_world(TASK, [0])
    yield world.spec
    world.close()


@pytest.mark.parametrize(
    "config",
    [
        GEOMETRIC,
        replace(GEOMETRIC, **TINY, log_std_init=-1e-05, ortho_init=False, log_std_end=-5.0, log_std_fall=(0.1, 0.5)),
        replace(GEOMETRIC, protocol=replace(GEOMETRIC.protocol, gamma=0.95, horizon=Uniform(3, 9))),
    ],
    ids=["usual", "settings", "protocol"],
)
@pytest.mark.parametrize("name", ["geometric", "mine", "ppo"])
def test_the_recorded_command_trains_the_same_run(spec, monkeypatch, config, name):
    run, found = TrainRun(TASK, name, config, (3,), base_method="geometric"), []
    monkeypatch.setattr("perdure.learn.run.train", lambda run, *_, **options: found.append(run) or [])
    run_command(split(command(run, spec, 3))[1:])
    assert found == [run]


def test_the_recorded_command_names_the_preset(spec):
    config = method_config("ppo", TASK, 4, "cleanrl")
    run = TrainRun(TASK, "mine", config, preset="cleanrl", base_method="ppo")
    assert command(run, spec, 0) == f"perdure train {TASK} --method ppo --name mine --preset cleanrl --seeds 0"


def test_disturbances_are_in_the_command_and_in_the_name(spec, monkeypatch):
    found = []
    monkeypatch.setattr("perdure.learn.run.train", lambda run, *_, **options: found.append(run) or [])
    run_command(["train", TASK, "--disturb", "action_noise:0.10", "action_delay:2"])
    run_command(["train", TASK, "--disturb", "action_delay:2", "action_noise:0.10"])
    run_command(split(command(found[0], spec, 0))[1:])
    assert found[0] == found[1] == found[2]
    assert (found[0].method, found[0].disturb) == (
        "geometric+action_delay-2+action_noise-0.1",
        ("action_delay:2", "action_noise:0.1"),
    )


def test_a_trained_policy_holds_the_command(tmp_path):
    (path,) = train(TrainRun(TASK, "mine", replace(PPO, **TINY), base_method="ppo"), tmp_path, cores=1)
    start = f"perdure train {TASK} --method ppo --name mine --preset zoo --seeds 0 --ppo.total-steps 64 "
    assert load_policy(path).provenance["command"].startswith(start)


def test_the_base_method_is_no_part_of_what_a_run_is():
    named, unnamed = TrainRun(TASK, "mine", PPO, base_method="ppo").unit(0), TrainRun(TASK, "mine", PPO).unit(0)
    assert (named.key, named.config) == (unnamed.key, unnamed.config)


def test_an_unknown_base_method_is_refused():
    with pytest.raises(PerdureError, match="did you mean 'geometric'"):
        TrainRun(TASK, "mine", PPO, base_method="geometrik")


@pytest.mark.parametrize(
    ("method", "config"),
    [
        ("ppo", replace(PPO, protocol=replace(PPO.protocol, horizon=Uniform(200, 1000)))),
        ("geometric", replace(GEOMETRIC, protocol=replace(GEOMETRIC.protocol, embedding=None))),
        ("geometric", replace(GEOMETRIC, protocol=replace(GEOMETRIC.protocol, embedding=Geometric(3)))),
        ("mine", PPO),
    ],
    ids=["horizon", "no embedding", "embedding", "no method"],
)
def test_no_command_is_recorded_where_no_flags_say_the_settings(spec, method, config):
    assert command(TrainRun(TASK, method, config), spec, 0) == ""


def test_braces_in_a_command_of_the_caller_s_own_are_kept(spec):
    run = TrainRun(TASK, "ppo", PPO, (3,), command="python t.py --opts '{\"a\": 1}' --seed {seed}")
    assert command(run, spec, 3) == "python t.py --opts '{\"a\": 1}' --seed 3"
