"""Cures whose answer is known: a robot that balances a pole, and one that drifts until it falls."""

import json
from dataclasses import replace

import numpy as np
import pytest
from probes import Walkway
from test_early import walk

import perdure
from perdure.cli import run as run_command
from perdure.envs import task_spec
from perdure.errors import PerdureError
from perdure.evaluate import Extrapolation, options, units
from perdure.evaluate.compare import compare
from perdure.horizon import Fixed, HorizonProtocol
from perdure.policy import Normalizer, Policy, TaskInfo, load_policy, save_policy
from perdure.policy.onnx import export_onnx
from perdure.report import read_table
from perdure.report.cure_page import Cured, headline
from perdure.report.estimates import estimate_table

pytestmark = pytest.mark.filterwarnings("ignore:standard-1 is applied without")
TASK = "InvertedPendulum-v4"
JUDGING = Extrapolation(steps=300, eval_seeds=2)
BALANCING = (1.0, 20.0, 1.5, 3.5)
DRIFTING = (0.0, 20.0, 0.0, 2.0)
FALLING = (-1.0, -20.0, -1.5, -3.5)


def pole(gains, seed=0, offset=0.0):
    """A policy that pushes the cart by these gains times (position, angle, velocity, angular velocity)."""
    small = 0.01  # where tanh is a line
    weights = {
        "policy.0.weight": np.eye(4) * small,
        "policy.0.bias": np.zeros(4),
        "policy.1.weight": np.array(gains)[:, None] / small,
        "policy.1.bias": np.array([offset]),
    }
    return Policy(
        task=TaskInfo.of(task_spec(TASK)),
        weights={name: each.astype(np.float32) for name, each in weights.items()},
        activation="tanh",
        normalizer=Normalizer(np.zeros(4), np.ones(4)),
        protocol=HorizonProtocol(None, Fixed(200), "truncated", 0.99, 0.99),
        provenance={"method": "ppo", "seed": seed},
    )


@pytest.fixture(autouse=True)
def short(monkeypatch):
    """16 disturbed episodes of 600 steps."""
    monkeypatch.setattr(options, "DISTURBED_STEPS", 600)
    monkeypatch.setattr(options, "DISTURBED_SEEDS", 16)


@pytest.fixture
def weak(tmp_path):
    return save_policy(pole(DRIFTING, offset=0.08), tmp_path / "weak.safetensors")


@pytest.fixture
def trained(tmp_path, monkeypatch):
    """A function that says which policies the further training makes; it returns the runs that were asked for."""
    asked = []

    def makes(*policies):
        def train(run, out, **where):
            asked.append(run)
            out.mkdir(parents=True, exist_ok=True)
            named = [replace(each, provenance={"method": run.method, "seed": k}) for k, each in enumerate(policies)]
            return [save_policy(each, out / f"seed-{k}.safetensors") for k, each in enumerate(named)]

        monkeypatch.setattr("perdure.evaluate.cure.train", train)
        return asked

    return makes


def cure(policy, out, **options):
    return perdure.cure(policy, out=out, evaluation=JUDGING, on="here", cores=1, **options)


def test_a_cure_that_helps_says_so_on_the_same_start_states(weak, trained, tmp_path):
    asked = trained(pole(BALANCING))
    result = cure(weak, tmp_path / "out")
    (run,) = asked
    assert run.start == weak
    assert run.config.total_steps == 300_000
    assert (result.verdict, result.helped, result.holds, result.met) == ("better", True, True, True)
    first = str(result).splitlines()[0]
    assert first.startswith(f"{TASK}: a fall every")
    assert "-> none in" in first
    assert "%" not in first, "a step pays the same to an idle robot, so nothing is known of speed"
    table, _ = read_table(tmp_path / "out" / "episodes.parquet")
    ends = table.filter(table["step"] == table["test_horizon"])
    seeds = [sorted(part["eval_seed"]) for part in ends.partition_by("policy")]
    assert seeds[0] == seeds[1] == sorted([0, 1, *range(16)])
    page = result.page.read_text()
    assert "Episodes that have not failed" in page
    assert "a fall every" in page
    assert load_policy(result.policy).provenance["method"] == "cured"


def test_a_cure_that_does_not_help_says_what_to_try_next(weak, trained, tmp_path):
    trained(pole(DRIFTING, offset=0.081))
    result = cure(weak, tmp_path / "out", require="better")
    assert (result.helped, result.holds, result.met) == (False, False, False)
    assert "did not help" in str(result).splitlines()[0]
    page = result.page.read_text()
    assert "--disturb standard-1" in page
    assert "--steps 1000000" in page


@pytest.mark.usefixtures("short_idle")
def test_the_first_line_says_what_of_the_reward_is_kept_and_when_training_harmed():
    both = compare(walk(1.0), walk(0.8), Walkway, steps=300, training_horizon=100, disturb="none", most=8)
    (items,) = estimate_table(both.frame).values()
    better = Cured("Walk", items[:1], items[1:], replace(both.summary, verdict="better"))
    fell = int((both.frame.filter(both.frame["step"] == 300)["end_step"] < 300).sum())
    assert fell > 0
    assert headline(better) == f"Walk: {fell} of 8 episodes fail -> 0 of 8 episodes fail, at 80 % of its reward"
    worse = replace(better, summary=replace(both.summary, verdict="worse"))
    assert "worse" in headline(worse)
    assert not worse.before[0].verdict.good
    assert worse.holds


def test_what_holds_already_is_not_trained(trained, tmp_path):
    asked = trained()
    result = cure(save_policy(pole(BALANCING), tmp_path / "strong.safetensors"), tmp_path / "out", require="holds")
    assert asked == []
    assert (result.verdict, result.policy, result.met) == ("held already", None, True)
    assert result.page.is_file()


def test_what_never_worked_is_refused_before_it_is_trained(trained, tmp_path):
    asked = trained()
    with pytest.raises(PerdureError, match="never worked"):
        cure(save_policy(pole(FALLING), tmp_path / "falling.safetensors"), tmp_path / "out")
    assert asked == []


def test_of_several_seeds_the_chosen_one_is_judged_where_it_was_not_chosen(weak, trained, tmp_path):
    trained(pole(DRIFTING, offset=0.081), pole(BALANCING))
    result = cure(weak, tmp_path / "out", seeds=(0, 1))
    assert load_policy(result.policy).provenance["seed"] == 1
    assert "seed 1 is the first of 2" in result.cured.selection
    assert result.evaluation.frame["eval_seed"].min() == 16
    assert "start states 16 and later" in str(result)


def test_a_finished_cure_runs_no_episode_again(weak, trained, tmp_path, monkeypatch):
    trained(pole(BALANCING))
    page = cure(weak, tmp_path / "out").page.read_bytes()
    monkeypatch.setattr(units, "evaluate_group", None)
    assert cure(weak, tmp_path / "out").page.read_bytes() == page


def test_a_folder_of_another_evaluation_is_not_replaced(weak, trained, tmp_path):
    trained(pole(BALANCING))
    cure(weak, tmp_path / "out")
    other = save_policy(pole(DRIFTING, offset=0.09), tmp_path / "other.safetensors")
    with pytest.raises(PerdureError, match="another evaluation"):
        cure(other, tmp_path / "out")
    with pytest.raises(PerdureError, match="Hopper-v3"):
        cure(weak, tmp_path / "elsewhere", env="Hopper-v3")
    with pytest.raises(PerdureError, match="did you mean 'seeds'"):
        cure(weak, tmp_path / "elsewhere", seed=(1,))


@pytest.mark.verify
def test_the_command_trains_a_network_in_onnx(weak, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(options, "CALM_STEPS", 300)
    model = export_onnx(load_policy(weak), tmp_path / "model.onnx")
    flags = ["--env", f"envpool:{TASK}", "--steps", "4000", "--out", str(tmp_path / "out"), "--on", "here", "--json"]
    run_command(["cure", str(model), *flags])
    answer = json.loads(capsys.readouterr().out)
    assert answer["task"] == TASK
    assert answer["verdict"] in ("better", "worse", "cannot tell")
    cured = load_policy(answer["policy"])
    assert cured.provenance["config"]["total_steps"] == 4000
    assert cured.provenance["config"]["protocol"]["gamma"] == 0.999
    assert cured.provenance["disturb"] == ["action_noise:0.1"]
    assert export_onnx(cured, tmp_path / "back.onnx").is_file()
