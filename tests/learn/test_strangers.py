"""Training continues policies of other libraries: each begins as its maker's, and is refused with a way out."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from perdure.cli import run as run_command
from perdure.errors import PerdureError
from perdure.horizon import Constant, Countdown
from perdure.learn.recipe import Recipe
from perdure.learn.run import Segments
from perdure.learn.start import start_file
from perdure.policy import Normalizer, TaskInfo, load_policy
from perdure.policy.onnx import OnnxModel, export_onnx
from perdure.policy.readers import FoundModel
from perdure.policy.readers.found import import_found, policies_by_seed, policy_file
from perdure.policy.readers.onnx_network import import_onnx
from tests.policy.make_policy import random_policy

FIXTURES = Path(__file__).parents[1] / "policy" / "readers" / "fixtures"
TASK = "gymnasium:Pendulum-v1"
PENDULUM = TaskInfo(TASK, 3, (-2.0,), (2.0,))
STATES = np.random.default_rng(1).normal(size=(40, 3))


def read(name, tmp_path, **options):
    """The policy of a file of another library."""
    return load_policy(policy_file(name, tmp_path, TASK, options, (), lambda sentence: None))


def theirs(path, nodes, **constants):
    """An ONNX model of these operators, from `obs` to `actions`."""
    arrays = [numpy_helper.from_array(np.asarray(each), name) for name, each in constants.items()]
    ends = [helper.make_tensor_value_info(n, TensorProto.FLOAT, [1, k]) for n, k in (("obs", 3), ("actions", 1))]
    graph = helper.make_graph(nodes, "theirs", ends[:1], ends[1:], arrays)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
    return path


def weights(*sizes):
    rng = np.random.default_rng(len(sizes))
    return [rng.normal(size=size).astype(np.float32) for size in sizes]


def rsl_rl(path, last="actions"):
    """As rsl_rl and torch write it: (obs - mean) / std, Gemm with transposed weights, Elu."""
    first, bias, second, offset = weights((8, 3), (8,), (1, 8), (1,))
    nodes = [
        helper.make_node("Sub", ["obs", "mean"], ["centered"]),
        helper.make_node("Div", ["centered", "std"], ["normal"]),
        helper.make_node("Gemm", ["normal", "first", "bias"], ["sum"], transB=1),
        helper.make_node("Elu", ["sum"], ["hidden"]),
        helper.make_node("Gemm", ["hidden", "second", "offset"], [last], transB=1),
    ]
    constants = {"mean": np.float32([[0.1, 0.2, -1.0]]), "std": np.float32([[1.0, 0.5, 4.0]])}
    constants |= {"first": first, "bias": bias, "second": second, "offset": offset}
    return nodes, constants


def plain_onnx(folder):
    nodes, constants = rsl_rl(folder)
    return theirs(folder / "policy.onnx", nodes, **constants)


def exported_onnx(folder):
    return export_onnx(random_policy(task=PENDULUM, embedding=None, activation="relu"), folder / "ours.onnx")


def zip_of(name):
    return lambda folder: FIXTURES / f"{name}.zip"


SOURCES = {
    **{name: (zip_of(name), FIXTURES / f"{name}.pkl") for name in ("ppo", "a2c")},
    "trpo": (zip_of("trpo"), "none"),
    "onnx": (plain_onnx, None),
    "ours in onnx": (exported_onnx, None),
}
"""Policies without a tanh at the end: what makes the file, and its normalizer."""


@pytest.mark.parametrize("source", SOURCES)
def test_training_begins_with_what_the_policy_does(source, tmp_path):
    make, normalizer = SOURCES[source]
    policy = read(make(tmp_path), tmp_path / "imported", normalizer=normalizer)
    segments = Segments(TASK, Recipe().config(policy, TASK), 1)
    begun = segments.algorithm.policy(segments.first(0, policy).learner)
    states = policy.normalizer.mean + STATES
    expected = policy.act(states, np.zeros(40))
    assert np.ptp(expected) > 0.01, "the network does something"
    np.testing.assert_allclose(begun.act(states, np.zeros(40)), expected, rtol=1e-4, atol=1e-5)


def test_the_statistics_of_a_vecnormalize_keep_their_count(tmp_path):
    policy = read(FIXTURES / "ppo.zip", tmp_path, normalizer=FIXTURES / "ppo.pkl")
    segments = Segments(TASK, Recipe().config(policy, TASK), 1)
    count = float(segments.first(0, policy).learner.statistics.observations.count)
    assert count == policy.provenance["observations"]
    steps = policy.provenance["steps"]
    assert steps <= count <= steps + 10, "one observation a step, and one of each reset"


@pytest.mark.parametrize("name", ["sac", "td3", "tqc", "ars-mlp", "ppo-sde"])
def test_a_squashed_policy_is_refused_with_its_reason(name, tmp_path):
    with pytest.raises(PerdureError, match=r"tanh.*own learner"):
        Recipe().config(read(FIXTURES / f"{name}.zip", tmp_path, normalizer="none"), TASK)


@pytest.mark.filterwarnings("ignore:the time feature counts down")
def test_a_time_feature_that_the_normalizer_saw_is_kept(tmp_path):
    model = FoundModel(FIXTURES / "ppo-time.zip", TASK, str(FIXTURES / "ppo-time.pkl"), "linear:50")
    policy = load_policy(import_found(model, None, {}, tmp_path, (), lambda sentence: None))
    config = Recipe().config(policy, TASK)
    assert config.protocol == replace(policy.protocol, gamma=0.999)
    segments = Segments(TASK, config, 1)
    begun = segments.algorithm.policy(segments.first(0, policy).learner)
    for clock in (Countdown(50.0), Constant(20.0)):
        expected = policy.act(STATES, np.arange(40.0), clock)
        np.testing.assert_allclose(begun.act(STATES, np.arange(40.0), clock), expected, rtol=1e-4, atol=1e-5)


def test_each_seed_continues_its_own_model(tmp_path):
    folder = tmp_path / "models"
    (folder / "seed-1").mkdir(parents=True)
    shutil.copy(FIXTURES / "trpo.zip", folder / "seed-0.zip")
    shutil.copy(plain_onnx(tmp_path), folder / "seed-1" / "policy.onnx")
    asked = (folder, (0, 1), tmp_path / "imported", TASK, {"normalizer": None}, lambda sentence: None)
    start = policies_by_seed(*asked)
    methods = [load_policy(start_file(start, seed)).provenance["method"] for seed in (0, 1)]
    assert methods == ["SB3 TRPO (seed-0)", "ONNX (policy)"]
    with pytest.raises(PerdureError, match="seed-2"):
        start_file(start, 2)


def test_the_command_continues_a_zip(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr("perdure.learn.run.train", lambda run, out, **options: asked.append(run) or [])
    zipped = ["--from", str(FIXTURES / "ppo.zip"), "--normalizer", str(FIXTURES / "ppo.pkl")]
    run_command(["train", TASK, "--method", "ppo", *zipped, "--seeds", "3", "--out", str(tmp_path)])
    (run,) = asked
    policy = load_policy(run.start)
    assert run.method == "ppo+continued"
    assert policy.provenance["method"] == "SB3 PPO (ppo)"
    assert run.config.hidden_sizes == tuple(len(policy.weights[f"policy.{k}.bias"]) for k in range(2))
    assert run.config.clip_obs == policy.normalizer.clip


# ONNX


def test_a_normalizer_in_the_graph_is_read_as_one(tmp_path):
    policy = import_onnx(plain_onnx(tmp_path), TASK, measure=False)
    np.testing.assert_allclose(policy.normalizer.mean, [0.1, 0.2, -1.0], rtol=1e-6)
    np.testing.assert_allclose(policy.normalizer.var, [1.0, 0.25, 16.0], rtol=1e-6)
    assert policy.activation == "elu"


@pytest.mark.parametrize("activation", ["relu", "tanh"])
def test_an_exported_policy_comes_back(activation, tmp_path):
    policy = random_policy(task=PENDULUM, embedding=None, activation=activation)
    back = import_onnx(export_onnx(policy, tmp_path / "x.onnx"), TASK, measure=False)
    np.testing.assert_allclose(back.act(STATES, np.zeros(40)), policy.act(STATES, np.zeros(40)), atol=1e-6)
    raw = random_policy(task=PENDULUM, embedding=None, normalizer=Normalizer.identity(3))
    assert import_onnx(export_onnx(raw, tmp_path / "raw.onnx"), TASK, measure=False).normalizer.clip >= 1e6


def altered(change):
    """A function that makes a model which `change` has altered."""

    def make(folder):
        nodes, constants = rsl_rl(folder)
        change(nodes, constants)
        return theirs(folder / "altered.onnx", nodes, **constants)

    return make


def _squashed(nodes, constants):
    nodes[-1].output[0] = "mean_action"
    nodes.append(helper.make_node("Tanh", ["mean_action"], ["actions"]))


def _steep(nodes, constants):
    nodes[3].attribute.append(helper.make_attribute("alpha", 2.0))


def _skipping(nodes, constants):
    nodes[3] = helper.make_node("Mul", ["sum", "sum"], ["hidden"])


def _normalized_layer(nodes, constants):
    constants["scale"] = np.ones(8, np.float32)
    nodes[3] = helper.make_node("LayerNormalization", ["sum", "scale"], ["hidden"])


def _narrow(nodes, constants):
    constants["bound"] = np.float32(0.5)
    nodes[-1].output[0] = "mean_action"
    nodes.append(helper.make_node("Min", ["mean_action", "bound"], ["actions"]))


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (_squashed, "tanh"),
        (_steep, "otherwise"),
        (_skipping, "joins"),
        (_normalized_layer, "LayerNormalization"),
        (_narrow, "range"),
    ],
)
def test_a_model_that_is_no_plain_network_is_refused(change, word, tmp_path):
    path = altered(change)(tmp_path)
    OnnxModel.load(path)  # control: it is a model
    with pytest.raises(PerdureError, match=word):
        import_onnx(path, TASK, measure=False)
