"""Policies as people have them in 2026: each is read, with the actions of its maker, or refused with the way out."""

from __future__ import annotations

import json
import pickle
import shutil
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
from altered import FIXTURES, rebuilt
from onnx import TensorProto, helper, numpy_helper
from safetensors.numpy import save_file

import perdure
from perdure.cli.show import model_text
from perdure.cli.subjects import policy_files
from perdure.errors import PerdureError, PerdureWarning
from perdure.evaluate import Execution, Extrapolation, evaluate_files
from perdure.evaluate.run import load
from perdure.policy import Policy, load_policy
from perdure.policy.onnx import OnnxModel, metadata, model_digest
from perdure.policy.readers import find_models, import_once, import_rsl_rl
from perdure.runs import Store, file_digest

RSL_RL = FIXTURES / "rsl_rl"
MANUAL = r"docs/how-to/any-policy\.md"
OBSERVATIONS = np.random.default_rng(3).normal(size=(20, 3))
SCALE = np.array([0.5, -0.25, 0.1])


def values(**shapes):
    return [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in shapes.items()]


def saved(path, nodes, inputs, outputs, notes=None, **constants):
    arrays = [numpy_helper.from_array(np.asarray(each), name) for name, each in constants.items()]
    graph = helper.make_graph(nodes, "theirs", inputs, outputs, arrays)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, notes or {})
    onnx.save(model, path)
    return path


def feed_forward(path, observation="obs", actions="actions", notes=None, others=()):
    """tanh(obs * SCALE) summed, for one observation; other outputs come before it."""
    nodes = [
        helper.make_node("Mul", [observation, "scale"], ["scaled"]),
        helper.make_node("ReduceSum", ["scaled", "axis"], ["sum"]),
        helper.make_node("Tanh", ["sum"], [actions]),
        *(helper.make_node("Identity", ["scaled"], [name]) for name in others),
    ]
    outputs = values(**{name: [1, 3] for name in others}, **{actions: [1, 1]})
    scale = SCALE.astype(np.float32)[None]
    return saved(path, nodes, values(**{observation: [1, 3]}), outputs, notes, scale=scale, axis=np.array([1]))


def recurrent(path, h_out=(2, 1, 3)):
    """h sums the observations, c halves itself and adds 1, both twice, batch in dimension 1; actions: h[0] + c[0]."""
    nodes = [
        helper.make_node("Add", ["h_in", "obs"], ["h_out"]),
        helper.make_node("Mul", ["c_in", "half"], ["halved"]),
        helper.make_node("Add", ["halved", "one"], ["c_out"]),
        helper.make_node("Add", ["h_out", "c_out"], ["both"]),
        helper.make_node("Gather", ["both", "first"], ["layer"], axis=0),
        helper.make_node("ReduceSum", ["layer", "axis"], ["actions"]),
    ]
    inputs = values(obs=[1, 3], h_in=[2, 1, 3], c_in=[2, 1, 3])
    outputs = values(actions=[1, 1], h_out=h_out, c_out=[2, 1, 3])
    constants = {"half": np.float32(0.5), "one": np.float32(1.0), "first": np.array(0), "axis": np.array([1])}
    return saved(path, nodes, inputs, outputs, **constants)


def motion(path, notes=None):
    nodes = [
        helper.make_node("Mul", ["obs", "scale"], ["actions"]),
        helper.make_node("Mul", ["obs", "time_step"], ["joint_pos"]),
    ]
    outputs = values(actions=[1, 3], joint_pos=[1, 3])
    return saved(path, nodes, values(obs=[1, 3], time_step=[1, 1]), outputs, notes, scale=np.float32(2.0))


MJLAB = {
    "run_path": "local",
    "joint_names": "left_hip,right_hip",
    "joint_stiffness": "40.179,0.000",
    "joint_damping": "2.558,2.558",
    "default_joint_pos": "-0.312,0.669",
    "command_names": "twist",
    "observation_names": "base_ang_vel,joint_pos,command",
    "observation_terms_scale": "1.000,1.000,0.250",
    "observation_terms_history_length": "0.000,0.000,3.000",
    "observation_terms_clip": "-inf;inf,-inf;inf,-1.000;1.000",
    "action_scale": "0.439,0.439",
}
"""As mjlab 1.6 writes it (mjlab/rl/exporter_utils.py)."""
HOLOSOMA = {"dof_names": '["left_hip", "right_hip"]', "kp": "[40.179238471, 99.098427777]", "kd": "[2.5, 6.3]"}


def plain(observations):
    return np.tanh((observations * SCALE).sum(axis=1, keepdims=True))


def summed(observations):
    steps = np.arange(1, len(observations) + 1)
    return (observations.cumsum(axis=0) + (2.0 - 0.5 ** (steps - 1.0))[:, None]).sum(axis=1, keepdims=True)


def recorded(name):
    return RSL_RL / name / "actions.npz"


def brax(tmp_path):
    (tmp_path / "params").write_bytes(pickle.dumps((np.zeros(3), {"params": {}})))
    return tmp_path / "params"


def playground(tmp_path):
    for name in ("_METADATA", "ppo_network_config.json"):
        (tmp_path / name).write_text("{}")
    return tmp_path


def lerobot(tmp_path):
    (tmp_path / "config.json").write_text(json.dumps({"type": "act"}))
    save_file({"model.weight": np.zeros((2, 2), np.float32)}, tmp_path / "model.safetensors")
    return tmp_path


def zoo(tmp_path):
    """As RL Zoo's repositories on Hugging Face: everything side by side, and a second zip."""
    shutil.copy(FIXTURES / "ppo.zip", tmp_path / "ppo-Pendulum-v1.zip")
    shutil.copy(FIXTURES / "ppo.pkl", tmp_path / "vec_normalize.pkl")
    (tmp_path / "train_eval_metrics.zip").write_bytes(b"PK\x03\x04")
    written = {"args.yml": [("env", "Pendulum-v1")], "config.yml": [("normalize", "true")]}
    for name, pairs in written.items():
        lines = "".join(f"- - {key}\n  - {value}\n" for key, value in pairs)
        (tmp_path / name).write_text("!!python/object/apply:collections.OrderedDict\n- " + lines.replace("\n", "\n  "))
    return tmp_path


READ = {
    "rsl_rl, weights beside the model": (lambda folder: RSL_RL / "mlp" / "policy.onnx", recorded("mlp")),
    "rsl_rl, LSTM": (lambda folder: RSL_RL / "lstm" / "policy.onnx", recorded("lstm")),
    "Isaac Lab, recurrent": (lambda folder: recurrent(folder / "policy.onnx"), summed),
    "mjlab, velocity": (lambda folder: feed_forward(folder / "run.onnx", notes=MJLAB), plain),
    "MuJoCo Playground": (lambda folder: feed_forward(folder / "go1.onnx", "obs", "continuous_actions"), plain),
    "several outputs": (lambda folder: feed_forward(folder / "a.onnx", others=("values", "latent")), plain),
    "holosoma, walking": (lambda folder: feed_forward(folder / "g1.onnx", "actor_obs", "action", HOLOSOMA), plain),
    "rsl_rl 5 checkpoint": (lambda folder: RSL_RL / "mlp" / "model_1.pt", recorded("mlp")),
    "rsl_rl 2 checkpoint": (lambda folder: RSL_RL / "before" / "model_1.pt", recorded("before")),
    "RL Zoo on Hugging Face": (zoo, FIXTURES / "actions.npz"),
}
REFUSED = {
    "motion tracking": (
        lambda folder: motion(folder / "dance.onnx"),
        rf"time_step selects the reference among its outputs \(actions, joint_pos\).*{MANUAL}#motion-tracking",
    ),
    "TorchScript": (lambda folder: RSL_RL / "mlp" / "policy.pt", rf"TorchScript.*ONNX: .*{MANUAL}#torchscript"),
    "Brax": (brax, rf"is a pickle: VecNormalize.*--normalizer.*{MANUAL}#brax"),
    "Brax, as an Orbax folder": (playground, rf"holds none; see .*{MANUAL}"),
    "LeRobot": (lerobot, rf"safetensors file, but not a perdure policy; LeRobot's: .*{MANUAL}#lerobot"),
}


def opened(path, folder):
    """What `perdure extrapolate PATH --env Pendulum-v1` would evaluate."""
    options = dict.fromkeys(("normalizer", "time_feature", "trust"))
    env = "Pendulum-v1"
    return load(policy_files([str(path)], env, options, None, folder / "out", ())[0])


@pytest.mark.filterwarnings("ignore::perdure.errors.PerdureWarning")
@pytest.mark.parametrize("name", READ)
def test_is_read_and_acts_as_its_maker(name, tmp_path):
    make, truth = READ[name]
    policy = opened(make(tmp_path), tmp_path)
    if callable(truth):
        observations, expected = OBSERVATIONS, truth(OBSERVATIONS)
    else:
        arrays = np.load(truth)
        observations, expected = arrays["observations"], arrays["actions" if "actions" in arrays else "ppo"]
    assert np.std(expected) > 0.005
    if isinstance(policy, Policy):
        found, expected = policy.act(observations, np.zeros(len(observations))), np.clip(expected, -2.0, 2.0)
    elif policy.state:
        found, state = [], None
        for step, row in enumerate(observations):
            actions, state = policy(row[None], state, np.array([step == 0]))
            found.append(actions[0])
    else:
        found = policy(observations)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=5e-6)


@pytest.mark.parametrize("name", REFUSED)
def test_is_refused_with_the_way_out(name, tmp_path):
    make, message = REFUSED[name]
    with pytest.raises(PerdureError, match=message):
        opened(make(tmp_path), tmp_path)


PAGE = (Path(__file__).parents[3] / "docs" / "how-to" / "any-policy.md").read_text()


def block(heading):
    """The code below a heading of the page."""
    return PAGE.partition(f"\n### {heading}\n")[2].partition("```python\n")[2].partition("```")[0]


def test_the_ways_out_are_on_the_page():
    for heading in ("TorchScript", "Motion tracking", "Brax", "LeRobot"):
        compile(block(heading), heading, "exec")
        assert len(block(heading)) > 50


def test_the_function_for_motion_tracking_feeds_the_reference_back(tmp_path):
    """actions = 2 obs; joint_pos = frame / 2, joint_vel = frame / 4; observation: what is seen plus both."""
    nodes = [helper.make_node("Mul", ["obs", "two"], ["actions"])]
    nodes += [helper.make_node("Mul", ["time_step", each], [f"joint_{each}"]) for each in ("pos", "vel")]
    outputs = values(actions=[1, 3], joint_pos=[1, 1], joint_vel=[1, 1])
    shares = {"two": np.float32(2.0), "pos": np.float32(0.5), "vel": np.float32(0.25)}
    path = saved(tmp_path / "dance.onnx", nodes, values(obs=[1, 3], time_step=[1, 1]), outputs, **shares)
    page = {"np": np, "session": onnxruntime.InferenceSession(path), "SIZE": 3, "FRAMES": 3}
    page["training_observation"] = lambda row, *reference: (row[None] + sum(reference)).astype(np.float32)
    exec(block("Motion tracking"), page)
    frame, seen = None, []
    for step in range(5):
        actions, frame = page["dance"](np.array([[1.0] * 3, [2.0] * 3]), frame, np.full(2, step == 0))
        seen.append(actions[:, 0].tolist())
    assert seen == [[2 * (1 + 0.75 * k), 2 * (2 + 0.75 * k)] for k in (0, 1, 2, 0, 1)]


class TestWeightsBesideTheModel:
    def copied(self, folder, location="policy.onnx.data", **place):
        """The model of rsl_rl with another place of its weights."""
        folder.mkdir(exist_ok=True)
        for name in ("policy.onnx", "policy.onnx.data"):
            shutil.copy(RSL_RL / "mlp" / name, folder / name)
        model = onnx.load(folder / "policy.onnx", load_external_data=False)
        for tensor in model.graph.initializer:
            for each in tensor.external_data:
                each.value = {"location": location, **place}.get(each.key, each.value)
        (folder / "policy.onnx").write_bytes(model.SerializeToString())
        return folder / "policy.onnx"

    def test_both_files_are_its_identity(self, tmp_path):
        path, other = self.copied(tmp_path / "a"), self.copied(tmp_path / "b")
        assert model_digest(path) == model_digest(other) != file_digest(path)
        weights = path.with_name("policy.onnx.data")
        weights.write_bytes(weights.read_bytes()[:-1] + b"\x01")
        assert model_digest(path) != model_digest(other)
        alone = feed_forward(tmp_path / "alone.onnx")
        assert model_digest(alone) == file_digest(alone)

    @pytest.mark.parametrize("location", ["../policy.onnx.data", "/etc/hostname", "..", "", "a\\b", "C:x", "a\0b"])
    def test_only_a_file_in_its_own_folder_is_read(self, tmp_path, location):
        shutil.copy(RSL_RL / "mlp" / "policy.onnx.data", tmp_path)
        path = self.copied(tmp_path / "model", location)
        for read in (OnnxModel.load, model_digest):
            with pytest.raises(PerdureError, match="folder"):
                read(path)

    def test_a_missing_file_is_named(self, tmp_path):
        path = self.copied(tmp_path / "model")
        path.with_name("policy.onnx.data").unlink()
        for read in (OnnxModel.load, model_digest):
            with pytest.raises(PerdureError, match=r"policy\.onnx\.data"):
                read(path)

    @pytest.mark.parametrize("place", [{"offset": "400"}, {"length": "999"}, {"offset": "-8"}, {"length": "-8"}])
    def test_weights_beyond_the_file_are_refused(self, tmp_path, place):
        with pytest.raises(PerdureError, match="do not fit together"):
            OnnxModel.load(self.copied(tmp_path / "model", **place))

    def test_the_size_is_bounded(self, tmp_path, monkeypatch):
        monkeypatch.setattr("perdure.policy.onnx.MAX_BYTES", 10_500)
        with pytest.raises(PerdureError, match="10,500"):
            OnnxModel.load(self.copied(tmp_path / "model"))

    def test_links_as_hugging_faces_cache_has_them_are_followed(self, tmp_path):
        path = self.copied(tmp_path / "blobs")
        (tmp_path / "snapshot").mkdir()
        for each in (path, path.with_name("policy.onnx.data")):
            (tmp_path / "snapshot" / each.name).symlink_to(each)
        linked = tmp_path / "snapshot" / "policy.onnx"
        assert np.array_equal(OnnxModel.load(linked)(OBSERVATIONS), OnnxModel.load(path)(OBSERVATIONS))


class TestState:
    def test_an_episode_does_not_depend_on_its_neighbors(self):
        """Bit for bit, though the batch is dimension 1 of the state."""
        model, rows = OnnxModel.load(RSL_RL / "lstm" / "policy.onnx"), OBSERVATIONS.reshape(5, 4, 3)

        def run(episodes):
            state, actions = None, []
            for step, seen in enumerate(rows[:, episodes]):
                action, state = model(seen, state, np.full(len(episodes), step == 0))
                actions.append(action)
            return np.stack(actions, axis=1)

        together = run([0, 1, 2, 3])
        assert together.tobytes() == np.concatenate([run([k]) for k in (0, 1, 2, 3)]).tobytes()
        assert not np.array_equal(together[:, 1:], model(rows[1])[0]), "the control: the state matters"

    def test_it_is_zero_where_an_episode_starts(self, tmp_path):
        model = OnnxModel.load(recurrent(tmp_path / "a.onnx"))
        _, state = model(np.ones((2, 3)))
        actions, _ = model(np.ones((2, 3)), state, np.array([False, True]))
        assert actions[:, 0].tolist() == [3 * (2 + 1.5), 3 * (1 + 1)]

    def test_an_output_of_another_shape_makes_no_state(self, tmp_path):
        with pytest.raises(PerdureError, match="obs, h_in, c_in"):
            OnnxModel.load(saved_with_other_state(tmp_path / "a.onnx"))

    def test_a_state_that_grows_is_refused(self, tmp_path):
        nodes = [
            helper.make_node("Concat", ["past_in", "obs"], ["past_out"], axis=0),
            helper.make_node("ReduceSum", ["past_out"], ["actions"]),
        ]
        outputs = values(actions=None, past_out=["more", 3])
        path = saved(tmp_path / "a.onnx", nodes, values(obs=[1, 3], past_in=["past", 3]), outputs)
        with pytest.raises(PerdureError, match="shape"):
            OnnxModel.load(path)(OBSERVATIONS)

    def test_an_evaluation_resumes_and_is_the_same_in_this_process(self, tmp_path):
        path = RSL_RL / "lstm" / "policy.onnx"
        asked = Extrapolation((path,), 40, eval_seeds=3, disturb=("none",), env="Pendulum-v1", training_horizon=20)

        def die(status):
            if any(key.startswith("groups") and each.state == "finished" for key, each in status.items()):
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            evaluate_files(replace(asked, max_episodes=1), Execution(tmp_path / "out", on="here", observe=die))
        assert 0 < len(set(Store(tmp_path / "out").keys("groups"))) < 3
        resumed = evaluate_files(asked, Execution(tmp_path / "out", on="here")).frame
        here = perdure.extrapolate(
            *(OnnxModel.load(path), "Pendulum-v1"), steps=40, eval_seeds=3, disturb="none", training_horizon=20
        )
        assert resumed["return"].equals(here.frame["return"])


def saved_with_other_state(path):
    model = onnx.load(recurrent(path))
    model.graph.node[0].input[0] = "wide"
    model.graph.initializer.append(numpy_helper.from_array(np.zeros((4, 1, 3), np.float32), "wide"))
    del model.graph.output[1]
    model.graph.output.extend(values(h_out=[4, 1, 3]))
    model.graph.node[3].input[0] = "h_in"
    onnx.save(model, path)
    return path


class TestInspect:
    def test_names_gains_and_scales_are_shown_beside_each_other(self, tmp_path):
        path = feed_forward(tmp_path / "run.onnx", notes=MJLAB)
        assert metadata(path) == MJLAB
        lines = model_text(str(path)).splitlines()
        assert lines[0].split() == ["inputs", "obs", "[1,", "3]"]
        assert [line.split() for line in lines if "_hip" in line] == [
            ["left_hip", "40.179", "2.558", "-0.312", "0.439"],
            ["right_hip", "0.000", "2.558", "0.669", "0.439"],
        ]
        assert ["command", "0.250", "3.000", "-1.000;1.000"] in [line.split() for line in lines]
        (warning,) = [line for line in lines if line.startswith("warning")]
        assert "rounded to three decimals: joint_stiffness, joint_damping, default_joint_pos" in warning

    def test_exact_gains_have_no_warning(self, tmp_path):
        text = model_text(str(feed_forward(tmp_path / "g1.onnx", notes=HOLOSOMA)))
        assert ["right_hip", "99.098427777", "6.3"] in [line.split() for line in text.splitlines()]
        assert "warning" not in text

    def test_a_model_that_is_not_evaluated_is_shown_with_the_reason(self, tmp_path):
        text = model_text(str(motion(tmp_path / "dance.onnx", {**MJLAB, "action_scale": "0.5", "note": "\x1b[2J"})))
        assert "tracks a motion" in text
        assert "40.179" in text
        assert ["action_scale", "0.5"] in [line.split() for line in text.splitlines()], "it is not one for each joint"
        assert "\x1b" not in text


class TestCheckpointsOfRslRl:
    def checkpoint(self, folder, old=b"", new=b""):
        """The checkpoint of rsl_rl 5 with words of the same length replaced."""
        data = (RSL_RL / "mlp" / "model_1.pt").read_bytes()
        path = folder / "model_1.pt"
        path.write_bytes(rebuilt(data, {"model_1/data.pkl": lambda pickled: pickled.replace(old, new)}))
        return path

    def test_the_activation_function_is_that_of_the_run(self, tmp_path):
        path = self.checkpoint(tmp_path)
        with pytest.warns(PerdureWarning, match=r"agent\.yaml.*elu"):
            assumed = import_once(path, tmp_path / "imported", "Pendulum-v1")
        assert load_policy(assumed).activation == "elu"
        (tmp_path / "params").mkdir()
        (tmp_path / "params" / "agent.yaml").write_text("actor:\n  activation: lrelu\ncritic:\n  activation: elu\n")
        assert load_policy(import_once(path, tmp_path / "imported", "Pendulum-v1")).activation == "leaky_relu"
        assert import_rsl_rl(path, "Pendulum-v1", activation="tanh", measure=False).activation == "tanh"

    def test_the_deviation_of_actions_is_named_otherwise_by_version_4(self, tmp_path):
        """`actor_state_dict.std`, in a pickle whose texts begin with their length."""
        old, new = (b"X" + len(name).to_bytes(4, "little") + name for name in (b"distribution.std_param", b"std"))
        options = {"activation": "elu", "measure": False}
        found = import_rsl_rl(self.checkpoint(tmp_path, old, new), "Pendulum-v1", **options)
        usual = import_rsl_rl(RSL_RL / "mlp" / "model_1.pt", "Pendulum-v1", **options)
        observations = np.random.default_rng(0).normal(size=(5, 3))
        assert new in zipfile.ZipFile(tmp_path / "model_1.pt").read("model_1/data.pkl")
        assert np.array_equal(found.act(observations, np.zeros(5)), usual.act(observations, np.zeros(5)))

    @pytest.mark.parametrize(
        ("old", "new", "message"),
        [
            (b"mlp.", b"rnn.", r"no plain perceptron, it has 'actor_state_dict\.rnn\..*export_policy_to_onnx"),
            (b"actor_state_dict", b"agent_state_dict", "is not a checkpoint of rsl_rl: it holds"),
            (b"mlp.4.", b"mlp.3.", r"linear layers at 0, 2, 4, ..., it has them at \[0, 2, 3\]"),
            (b"collections", b"subprocesss", "asks for the Python object 'subprocesss.OrderedDict', which was not run"),
        ],
    )
    def test_others_are_refused(self, tmp_path, old, new, message):
        with pytest.raises(PerdureError, match=message):
            import_rsl_rl(self.checkpoint(tmp_path, old, new), "Pendulum-v1", activation="elu", measure=False)

    def test_another_environment_and_flags_of_other_libraries_are_refused(self, tmp_path):
        path = self.checkpoint(tmp_path)
        with pytest.raises(PerdureError, match=r"Acrobot.*6"):
            import_rsl_rl(path, "Acrobot-v1", activation="elu", measure=False)
        (found,) = find_models(path)
        with pytest.raises(PerdureError, match="--normalizer"):
            import_once(found.path, tmp_path, "Pendulum-v1", normalizer="none", trust=False)


@pytest.mark.verify
@pytest.mark.filterwarnings("ignore::perdure.errors.PerdureWarning")
def test_what_rsl_rl_exports_today_acts_as_its_own_modules(tmp_path, monkeypatch):
    """With another random policy than the fixtures', and a GRU, for an installed rsl-rl-lib."""
    pytest.importorskip("rsl_rl")
    script = Path(__file__).with_name("make_rsl_rl_fixtures.py")
    subprocess.run([sys.executable, str(script), str(tmp_path)], check=True, timeout=600, capture_output=True)
    for kind in ("mlp", "lstm", "gru"):
        arrays, model = np.load(tmp_path / kind / "actions.npz"), OnnxModel.load(tmp_path / kind / "policy.onnx")
        found, state = [], None
        for row in arrays["observations"]:
            returned = model(row[None], state) if model.state else (model(row[None]), None)
            found.append(returned[0][0])
            state = returned[1]
        assert len(model.state) == {"mlp": 0, "lstm": 2, "gru": 1}[kind]
        np.testing.assert_allclose(found, arrays["actions"], rtol=1e-5, atol=5e-6)
    arrays = np.load(tmp_path / "mlp" / "actions.npz")
    monkeypatch.chdir(tmp_path / "mlp")
    exec(block("TorchScript").replace("48", "3"), {"torch": pytest.importorskip("torch")})
    converted = np.concatenate([OnnxModel.load("policy.onnx")(row[None]) for row in arrays["observations"]])
    np.testing.assert_allclose(converted, arrays["actions"], rtol=1e-5, atol=5e-6)
    policy = import_rsl_rl(tmp_path / "mlp" / "model_1.pt", "Pendulum-v1", measure=False)
    found = policy.act(arrays["observations"], np.zeros(len(arrays["observations"])))
    np.testing.assert_allclose(found, np.clip(arrays["actions"], -2.0, 2.0), rtol=1e-5, atol=5e-6)
