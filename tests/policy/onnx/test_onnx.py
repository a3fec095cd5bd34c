"""A policy as an ONNX model acts as the policy does; models of other makers act through the same door."""

from __future__ import annotations

import os
import signal
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import TensorProto, helper, numpy_helper

import perdure
from perdure.envs import task_spec
from perdure.errors import PerdureError
from perdure.evaluate import Execution, Extrapolation, evaluate_files
from perdure.horizon import Constant, Countdown, Fixed, HorizonProtocol, Periodic, TimeFeature, Uniform
from perdure.policy import load_policy
from perdure.policy.network import ACTIVATIONS
from perdure.policy.onnx import OnnxModel, export_onnx
from perdure.policy.policy import TanhSquash
from perdure.runs import Store

sys.path.insert(0, str(Path(__file__).parents[1]))
from make_policy import random_policy

RNG = np.random.default_rng(7)
DEVIATIONS = RNG.standard_normal((1000, 11))
OBSERVATIONS = 1.5 * DEVIATIONS
ELAPSED = RNG.integers(0, 3000, 1000).astype(np.float64)
HORIZONS = np.where(RNG.random(1000) < 0.1, np.inf, RNG.integers(0, 3000, 1000))


def session(path):
    """The model as somebody else's program runs it: onnxruntime alone."""
    return onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])


def with_embedding(embedding, **parts):
    protocol = HorizonProtocol(embedding, Uniform(200, 1000), "terminated", 1.0, 1.0)
    return random_policy(embedding="linear" if embedding.size == 1 else "geometric", protocol=protocol, **parts)


POLICIES = {
    "plain": random_policy(embedding=None, activation="relu"),
    "linear": random_policy(embedding="linear"),
    "geometric": random_policy(embedding="geometric", hidden=(64, 64)),
    "film": random_policy(film=True, hidden=(64, 64)),
    "normalized phi": random_policy(embedding="geometric", normalize_embedding=True),
    "time feature": with_embedding(TimeFeature(1000)),
    "squashed": random_policy(embedding=None, squash=TanhSquash()),
    "squashed with a limit": random_policy(embedding="linear", squash=TanhSquash(2.0)),
    "16 bits": random_policy(embedding="linear").halved(),
    **{name: random_policy(embedding="linear", activation=name, seed=3) for name in ACTIVATIONS},
    "shipped": load_policy("Hopper-v3/geometric"),
}


@pytest.mark.parametrize("name", POLICIES)
def test_with_time_as_an_input_actions_are_the_policys(tmp_path, name):
    policy = POLICIES[name]
    observations = policy.normalizer.mean[:11] + policy.observation_std * DEVIATIONS
    model = session(export_onnx(policy, tmp_path / "policy.onnx"))
    times = {"elapsed": ELAPSED, "horizon": HORIZONS} if policy.has_clock else {}
    assert {each.name for each in model.get_inputs()} == {"observation", *times}
    (found,) = model.run(["action"], {"observation": observations, **times})
    expected = policy.act_at(observations, ELAPSED, HORIZONS)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)
    assert np.std(expected) > 0.05, "the control: actions differ from one another"
    other = policy.act_at(observations + 0.01, ELAPSED, HORIZONS)
    assert np.abs(found - other).max() > 1e-4, "the control: a slightly other observation is noticed"


@pytest.mark.parametrize("clock", [Constant(500.0), Constant(0.0), Periodic(300.0), Periodic(0.0), Countdown(1500.0)])
def test_with_a_clock_in_the_model_actions_are_those_under_this_clock(tmp_path, clock):
    policy = POLICIES["geometric"]
    model = session(export_onnx(policy, tmp_path / "policy.onnx", clock))
    names = {each.name for each in model.get_inputs()}
    assert names == ({"observation"} if isinstance(clock, Constant) else {"observation", "elapsed"})
    feed = {"observation": OBSERVATIONS, "elapsed": ELAPSED}
    (found,) = model.run(None, {name: feed[name] for name in names})
    np.testing.assert_allclose(found, policy.act(OBSERVATIONS, ELAPSED, clock), rtol=0, atol=1e-6)
    assert np.abs(found - policy.act(OBSERVATIONS, ELAPSED, Constant(37.0))).max() > 1e-3, "the control"


def test_an_embedding_of_somebody_elses_is_exported_too(tmp_path):
    from dataclasses import dataclass
    from typing import ClassVar

    from perdure.horizon import Embedding

    @dataclass(frozen=True)
    class Reciprocal(Embedding):
        name: ClassVar[str] = "reciprocal_for_onnx"
        size: ClassVar[int] = 1

        def __call__(self, elapsed, horizon):
            phi = 1.0 / (1.0 + (horizon - elapsed) * (horizon > elapsed))
            return phi[..., None] if hasattr(phi, "ndim") else np.asarray(phi)[..., None]

    policy = with_embedding(Reciprocal())
    model = session(export_onnx(policy, tmp_path / "policy.onnx"))
    finite = np.minimum(HORIZONS, 5000)
    (found,) = model.run(None, {"observation": OBSERVATIONS, "elapsed": ELAPSED, "horizon": finite})
    np.testing.assert_allclose(found, policy.act_at(OBSERVATIONS, ELAPSED, finite), rtol=0, atol=1e-6)


def test_the_model_says_what_it_is_for_and_one_row_is_enough(tmp_path):
    policy = POLICIES["shipped"]
    path = export_onnx(policy, tmp_path / "policy.onnx", Constant(500.0))
    model = session(path)
    notes = model.get_modelmeta().custom_metadata_map
    assert notes["perdure.task"] == "Hopper-v3"
    assert notes["perdure.clock"] == "constant(500)"
    (one,) = model.run(None, {"observation": OBSERVATIONS[:1]})
    np.testing.assert_allclose(one, policy.act(OBSERVATIONS[:1], [0.0], Constant(500.0)), atol=1e-6)
    assert path.read_bytes() == export_onnx(policy, tmp_path / "again.onnx", Constant(500.0)).read_bytes()


def test_a_model_that_acts_otherwise_is_not_written(tmp_path, monkeypatch):
    from perdure.policy import onnx_export

    monkeypatch.setitem(onnx_export.OPERATORS, "tanh", "Softsign")
    with pytest.raises(PerdureError, match="differ"):
        export_onnx(POLICIES["geometric"], tmp_path / "policy.onnx")
    assert list(tmp_path.iterdir()) == []


def test_a_clock_for_a_policy_without_time_is_refused(tmp_path):
    with pytest.raises(PerdureError, match="time-to-go"):
        export_onnx(POLICIES["plain"], tmp_path / "policy.onnx", Constant(500.0))


def test_without_onnx_the_extra_is_named(tmp_path, monkeypatch):
    from perdure.policy import onnx

    monkeypatch.setattr(onnx, "find_spec", lambda name: None)
    with pytest.raises(PerdureError, match=r"pip install 'perdure\[onnx\]'"):
        export_onnx(POLICIES["plain"], tmp_path / "policy.onnx")


SIZES = {"obs": 3, "actions": 1}


class TestModelsOfOtherMakers:
    def made(self, path, nodes, inputs, outputs, constants=(), opsets=(("", 17),)):
        graph = helper.make_graph(nodes, "theirs", inputs, outputs, list(constants))
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid(*each) for each in opsets], ir_version=8)
        onnx.save(model, path)
        return path

    def linear(self, path, batch="batch", extra_inputs=(), **options):
        """obs (batch, 11), 32 bits, to actions tanh(0.1 obs W), with values as another output before them."""
        weight = numpy_helper.from_array(np.eye(11, 3, dtype=np.float32), "W")
        nodes = [
            helper.make_node("ReduceSum", ["obs"], ["values"]),
            helper.make_node("MatMul", ["obs", "W"], ["mean"]),
            helper.make_node("Tanh", ["mean"], ["actions"]),
        ]
        observation = helper.make_tensor_value_info("obs", TensorProto.FLOAT, [batch, 11])
        values = helper.make_tensor_value_info("values", TensorProto.FLOAT, None)
        actions = helper.make_tensor_value_info("actions", TensorProto.FLOAT, [batch, 3])
        return self.made(path, nodes, [observation, *extra_inputs], [values, actions], [weight], **options)

    @pytest.mark.parametrize("batch", ["batch", 1, 3])
    def test_act_whatever_their_batch(self, tmp_path, batch):
        model = OnnxModel.load(self.linear(tmp_path / "theirs.onnx", batch))
        np.testing.assert_allclose(model(OBSERVATIONS[:20]), np.tanh(OBSERVATIONS[:20, :3]), atol=1e-6)

    def test_are_evaluated_like_the_same_function(self, tmp_path):
        path = self.linear(tmp_path / "theirs.onnx")
        options = {"env": "envpool:Hopper-v4", "steps": 100, "eval_seeds": 3, "disturb": "none"}
        found = perdure.extrapolate(path, **options, on="here").frame
        model = OnnxModel.load(path)
        assert found.equals(perdure.extrapolate(model, **options).frame)
        function = perdure.extrapolate(lambda seen: model(seen), **options).frame
        assert found["return"].equals(function["return"])
        assert found["policy"][0] == "theirs"

    def test_resume_and_give_one_table_on_any_number_of_cores(self, tmp_path):
        path = self.linear(tmp_path / "theirs.onnx", 3)
        seeds = {"eval_seeds": 4, "disturb": ("none",)}
        asked = Extrapolation((path,), 60, **seeds, env="envpool:Hopper-v4", training_horizon=50)

        def die(status):
            if any(key.startswith("groups") and each.state == "finished" for key, each in status.items()):
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            evaluate_files(replace(asked, max_episodes=1), Execution(tmp_path / "out", on="here", observe=die))
        done = set(Store(tmp_path / "out").keys("groups"))
        assert 0 < len(done) < 4
        resumed = evaluate_files(asked, Execution(tmp_path / "out", on="here", cores=2))
        assert resumed.frame.equals(evaluate_files(asked, Execution(on="here")).frame)
        assert set(Store(tmp_path / "out").keys("groups")) > done
        with pytest.raises(PerdureError, match="another evaluation"):
            evaluate_files(replace(asked, training_horizon=60), Execution(tmp_path / "out", on="here"))

    def test_act_on_each_row_alone(self, tmp_path):
        for batch in ("batch", 1, 3):
            model = OnnxModel.load(self.linear(tmp_path / "theirs.onnx", batch))
            rows = np.concatenate([model(OBSERVATIONS[k : k + 1]) for k in range(20)])
            assert model(OBSERVATIONS[:20]).tobytes() == rows.tobytes()

    def test_a_custom_operator_is_refused_and_nothing_is_loaded(self, tmp_path):
        node = helper.make_node("Backdoor", ["obs"], ["actions"], domain="evil.ops")
        info = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", 3]) for name in ("obs", "actions")]
        path = self.made(tmp_path / "evil.onnx", [node], info[:1], info[1:], opsets=(("", 17), ("evil.ops", 1)))
        with pytest.raises(PerdureError, match=r"evil\.ops"):
            OnnxModel.load(path)

    def test_a_domain_that_is_only_declared_or_defined_inside_needs_no_library(self, tmp_path):
        node = helper.make_node("Mine", ["obs"], ["actions"], domain="pkg.local")
        info = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", 3]) for name in ("obs", "actions")]
        opsets = (("", 17), ("pkg.local", 1), ("pkg.onnxscript.torch_lib.common", 1))
        path = self.made(tmp_path / "own.onnx", [node], info[:1], info[1:], opsets=opsets)
        with pytest.raises(PerdureError, match=r"pkg\.local"):
            OnnxModel.load(path)
        model = onnx.load(path)
        body = [helper.make_node("Neg", ["x"], ["y"])]
        model.functions.append(
            helper.make_function("pkg.local", "Mine", ["x"], ["y"], body, [helper.make_opsetid("", 17)])
        )
        onnx.save(model, path)
        assert OnnxModel.load(path)(np.ones((2, 3))).tolist() == [[-1.0] * 3] * 2

    def test_a_custom_operator_inside_a_branch_is_refused(self, tmp_path):
        def branch(domain):
            out = helper.make_tensor_value_info("inner", TensorProto.FLOAT, None)
            return helper.make_graph([helper.make_node("Identity", ["obs"], ["inner"], domain=domain)], "b", [], [out])

        yes = numpy_helper.from_array(np.array(True), "yes")
        node = helper.make_node("If", ["yes"], ["actions"], then_branch=branch("evil.ops"), else_branch=branch(""))
        info = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", 3]) for name in ("obs", "actions")]
        path = self.made(tmp_path / "evil.onnx", [node], info[:1], info[1:], [yes])
        with pytest.raises(PerdureError, match=r"evil\.ops"):
            OnnxModel.load(path)

    @pytest.mark.parametrize("place", ["initializer", "attribute"])
    def test_sparse_weights_in_another_file_are_refused(self, tmp_path, place):
        values = TensorProto(name="W", data_type=TensorProto.FLOAT, dims=[2], data_location=TensorProto.EXTERNAL)
        values.external_data.add(key="location", value="weights.bin")
        indices = numpy_helper.from_array(np.array([0, 1], np.int64), "W_indices")
        weight = helper.make_sparse_tensor(values, indices, [3, 1])
        nodes = [helper.make_node("MatMul", ["obs", "W"], ["actions"])]
        if place == "attribute":
            nodes.insert(0, helper.make_node("Constant", [], ["W"], sparse_value=weight))
        info = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", k]) for name, k in SIZES.items()]
        graph = helper.make_graph(nodes, "sparse", info[:1], info[1:])
        if place == "initializer":
            graph.sparse_initializer.append(weight)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
        with pytest.raises(PerdureError, match="another file"):
            OnnxModel(model.SerializeToString(), "sparse")

    def cast(self, kind, shape):
        """A model of observations of a kind: the sum of each."""
        nodes = [
            helper.make_node("Cast", ["obs"], ["numbers"], to=TensorProto.FLOAT),
            helper.make_node("Flatten", ["numbers"], ["flat"]),
            helper.make_node("ReduceSum", ["flat", "axis"], ["actions"]),
        ]
        info = [
            helper.make_tensor_value_info("obs", kind, shape),
            helper.make_tensor_value_info("actions", TensorProto.FLOAT, None),
        ]
        axis = numpy_helper.from_array(np.array([1], np.int64), "axis")
        graph = helper.make_graph(nodes, "cast", info[:1], info[1:], [axis])
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
        return OnnxModel(model.SerializeToString(), "cast")

    @pytest.mark.parametrize("kind", [TensorProto.INT32, TensorProto.INT64, TensorProto.BOOL, TensorProto.DOUBLE])
    def test_observations_may_have_another_type(self, kind):
        rows = np.array([[0, 1, 1], [1, 1, 1]])
        assert self.cast(kind, ["n", 3])(rows)[:, 0].tolist() == [2.0, 3.0]

    def test_an_unknown_type_and_batches_of_nothing_are_refused_when_it_is_loaded(self):
        with pytest.raises(PerdureError, match="int8"):
            self.cast(TensorProto.INT8, ["n", 3])
        with pytest.raises(PerdureError, match="batches of 0"):
            self.cast(TensorProto.FLOAT, [0, 3])

    @pytest.mark.parametrize("kind", [TensorProto.INT32, TensorProto.BOOL])
    @pytest.mark.parametrize("number", [0.5, np.nan, -3e10])
    def test_numbers_that_the_model_cannot_hold_are_refused(self, kind, number):
        with pytest.raises(PerdureError, match=r"tensor\((int32|bool)\)"):
            self.cast(kind, ["n", 3])(np.array([[0.0, 1.0, number]]))

    def test_sizes_that_are_not_the_task_s_are_refused_where_the_model_tells_them(self):
        model = self.cast(TensorProto.FLOAT, ["n", 3])
        model.check_sizes(task_spec("gymnasium:Pendulum-v1"))
        with pytest.raises(PerdureError, match=r"3.*11"):
            model.check_sizes(task_spec("gymnasium:Hopper-v5"))
        self.cast(TensorProto.FLOAT, ["n", "a"]).check_sizes(task_spec("gymnasium:InvertedPendulum-v5"))

    def test_several_open_dimensions_are_those_of_the_observations(self):
        assert self.cast(TensorProto.FLOAT, ["n", "a", "b"])(np.ones((4, 2, 3)))[:, 0].tolist() == [6.0] * 4

    @pytest.mark.parametrize("data", [b"", b"a shopping list", b"\x08\x08", bytes(1000)])
    def test_what_is_no_model_is_refused(self, tmp_path, data):
        path = tmp_path / "none.onnx"
        path.write_bytes(data)
        with pytest.raises(PerdureError, match="is not an ONNX model"):
            OnnxModel.load(path)

    def test_a_cut_or_changed_file_is_refused_or_acts(self, tmp_path):
        """No mutation may do more than that."""
        data = self.linear(tmp_path / "theirs.onnx").read_bytes()
        rng = np.random.default_rng(0)
        refused = 0
        for k in range(60):
            changed = bytearray(data)
            changed[rng.integers(len(data))] ^= 1 << rng.integers(8)
            try:
                OnnxModel(bytes(changed if k % 2 else data[: rng.integers(len(data))]), "changed")(OBSERVATIONS[:2])
            except PerdureError:
                refused += 1
        assert refused > 20

    def test_a_missing_file_a_second_observation_and_a_wrong_size_are_refused(self, tmp_path):
        with pytest.raises(PerdureError, match="there is no file"):
            OnnxModel.load(tmp_path / "none.onnx")
        second = helper.make_tensor_value_info("state", TensorProto.FLOAT, [1, 4])
        with pytest.raises(PerdureError, match="obs, state"):
            OnnxModel.load(self.linear(tmp_path / "two.onnx", extra_inputs=[second]))
        model = OnnxModel.load(self.linear(tmp_path / "theirs.onnx"))
        with pytest.raises(PerdureError, match=r"\(n, 11\).*\(20, 10\)"):
            model(OBSERVATIONS[:20, :10])


class TestTrainingHorizon:
    def test_an_exported_model_knows_its_own_and_the_caller_may_name_another(self, tmp_path):
        protocol = replace(POLICIES["plain"].protocol, horizon=Fixed(300))
        path = export_onnx(replace(POLICIES["plain"], protocol=protocol), tmp_path / "short.onnx")
        assert OnnxModel.load(path).training_horizon == 300
        options = {
            "env": "Hopper-v3",
            "steps": 20,
            "eval_seeds": 1,
            "disturb": "none",
        }  # Hopper-v3 has a limit of 1,000 steps
        options |= {"on": "here"}
        assert perdure.extrapolate(path, **options).frame["train_horizon"].unique().to_list() == [300.0]
        named = perdure.extrapolate(path, training_horizon=50, **options).frame
        assert named["train_horizon"].unique().to_list() == [50.0]

    @pytest.mark.parametrize(("text", "steps"), [("1000.0", 1000), ("inf", None), (None, None)])
    def test_is_read_from_the_metadata(self, tmp_path, text, steps):
        assert OnnxModel.load(self.noted(tmp_path / "noted.onnx", text)).training_horizon == steps

    @pytest.mark.parametrize("text", ["long", "0", "-5", "nan"])
    def test_that_makes_no_sense_is_refused(self, tmp_path, text):
        with pytest.raises(PerdureError, match=f"training_horizon.*'{text}'"):
            OnnxModel.load(self.noted(tmp_path / "noted.onnx", text))

    def noted(self, path, text):
        model = onnx.load(export_onnx(POLICIES["plain"], path))
        kept = [each for each in model.metadata_props if each.key != "perdure.training_horizon"]
        del model.metadata_props[:]
        model.metadata_props.extend(kept)
        if text is not None:
            model.metadata_props.add(key="perdure.training_horizon", value=text)
        onnx.save(model, path)
        return path


class TestTime:
    def test_a_model_with_time_as_an_input_is_evaluated_under_clocks(self, tmp_path):
        policy = replace(POLICIES["geometric"], reference=None)
        path = export_onnx(policy, tmp_path / "timed.onnx")
        options = {"env": "Hopper-v3", "steps": 60, "clocks": "constant:300", "eval_seeds": 2, "disturb": "none"}
        found = perdure.extrapolate(path, training_horizon=1000, **options, on="here").frame
        own = perdure.extrapolate(policy, **options).frame
        np.testing.assert_allclose(found["return"], own["return"], rtol=1e-3)
        assert found["clock"].unique().to_list() == ["constant(300)"]
        with pytest.raises(PerdureError, match="clock"):
            perdure.extrapolate([path, "Hopper-v3/geometric"], env="envpool:Hopper-v3", steps=60, on="here")

    def test_a_running_clock_is_refused(self, tmp_path):
        path = export_onnx(POLICIES["geometric"], tmp_path / "runs.onnx", Periodic(300.0))
        with pytest.raises(PerdureError, match="counts time itself"):
            perdure.extrapolate(path, env="Hopper-v3", steps=60)


def counting(rounds):
    """A model that adds 1 to the sum of four numbers in each round of a loop."""
    scalar, column = [], [1, 1]
    going_in = [("i", TensorProto.INT64, scalar), ("on", TensorProto.BOOL, scalar), ("sum", TensorProto.FLOAT, column)]
    going_out = [("still", TensorProto.BOOL, scalar), ("more", TensorProto.FLOAT, column)]
    steps = [helper.make_node("Identity", ["on"], ["still"]), helper.make_node("Add", ["sum", "one"], ["more"])]
    inside, outside = ([helper.make_tensor_value_info(*each) for each in part] for part in (going_in, going_out))
    one = numpy_helper.from_array(np.ones((1, 1), np.float32), "one")
    body = helper.make_graph(steps, "body", inside, outside, [one])
    constants = [
        numpy_helper.from_array(np.array(rounds), "rounds"),
        numpy_helper.from_array(np.array(True), "on"),
        numpy_helper.from_array(np.ones((4, 1), np.float32), "ones"),
    ]
    nodes = [
        helper.make_node("MatMul", ["obs", "ones"], ["start"]),
        helper.make_node("Loop", ["rounds", "on", "start"], ["action"], body=body),
    ]
    seen = helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, 4])
    action = helper.make_tensor_value_info("action", TensorProto.FLOAT, [1, 1])
    graph = helper.make_graph(nodes, "counting", [seen], [action], constants)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8).SerializeToString()


def test_a_loop_without_an_end_ends_with_an_interruption():
    assert OnnxModel(counting(3), "three.onnx")(np.ones((2, 4))).tolist() == [[7.0], [7.0]]
    endless = OnnxModel(counting(2**62), "endless.onnx")
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # jobs in the background of a shell ignore it
    try:
        threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()
        with pytest.raises(KeyboardInterrupt):
            endless(np.ones((1, 4)))
    finally:
        signal.signal(signal.SIGINT, before)
    endless._thread.shutdown()  # waits for the loop


def test_flipped_bits_are_refused_or_harmless(capsys):
    """Every bit of a model in turn, one in eleven."""
    whole, refused = counting(3), list[str]()
    for bit in range(0, 8 * len(whole), 11):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        try:
            OnnxModel(bytes(damaged), "damaged.onnx")
        except PerdureError as error:
            refused.append(str(error))
    assert len(refused) > 20
    assert all(each.startswith("damaged.onnx") for each in refused)
    assert capsys.readouterr() == ("", "")
