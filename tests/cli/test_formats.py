"""Policies go out as ONNX models, films and cards, and models of other makers come in, by command line."""

import numpy as np
import onnxruntime
import pytest

from perdure.horizon import Constant
from perdure.policy import load_policy
from perdure.report import read_table


def succeeded(process):
    assert process.returncode == 0, process.stderr
    return process.stdout


def refused(process):
    """The one line on stderr of a command that was refused."""
    assert process.returncode == 2
    (line,) = process.stderr.strip().splitlines()
    return line


@pytest.mark.parametrize("command", ["export", "watch", "card"])
def test_each_command_is_listed_and_explains_itself(perdure, tmp_path, command):
    assert f"perdure {command} " in succeeded(perdure(cwd=tmp_path))
    assert "usage: perdure" in succeeded(perdure(command, "--help", cwd=tmp_path))


def test_a_policy_is_exported_and_evaluated_as_an_onnx_model(perdure, files, tmp_path):
    file = files / "timed.safetensors"
    assert succeeded(perdure("export", file, "p.onnx", "--clock", "constant:20", cwd=tmp_path)).strip() == "p.onnx"
    rows = np.random.default_rng(0).standard_normal((50, 4))
    (actions,) = onnxruntime.InferenceSession(tmp_path / "p.onnx").run(None, {"observation": rows})
    expected = load_policy(file).act(rows, np.zeros(50), Constant(20.0))
    np.testing.assert_allclose(actions, expected, atol=1e-6)
    flags = ("--env", "envpool:InvertedPendulum-v4", "--steps", 30, "--eval-seeds", 2, "--out", "out")
    assert "Report: " in succeeded(perdure("extrapolate", "p.onnx", *flags, cwd=tmp_path))
    frame, notes = read_table(tmp_path / "out" / "lanes.parquet")
    assert set(frame["policy"]) == {"p"}
    assert notes["command"].startswith("perdure extrapolate p.onnx --env")


def test_the_clock_default_is_the_policys_own(perdure, files, tmp_path):
    succeeded(perdure("export", files / "timed.safetensors", "own.onnx", "--clock", "default", cwd=tmp_path))
    model = onnxruntime.InferenceSession(tmp_path / "own.onnx")
    assert model.get_modelmeta().custom_metadata_map["perdure.clock"] == "constant(50)"


def test_a_card_lies_beside_the_policy(perdure, files, tmp_path):
    (tmp_path / "shared").mkdir()
    (tmp_path / "shared" / "policy.safetensors").write_bytes((files / "timed.safetensors").read_bytes())
    flags = ("--steps", 30, "--eval-seeds", 2, "--cores", 1, "--out", "out")
    succeeded(perdure("extrapolate", "shared", *flags, cwd=tmp_path))
    path = succeeded(perdure("card", "shared", "--table", "out/lanes.parquet", cwd=tmp_path)).strip()
    assert path == "shared/README.md"
    assert "# timed on InvertedPendulum-v4" in (tmp_path / path).read_text()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("export", "{timed}", "p.txt"), "out must be a file named .onnx, not p.txt"),
        (("export", "{timed}", "p.onnx", "--clock", "never:3"), "unknown Clock 'never'"),
        (("export", "{timeless}", "p.onnx", "--clock", "constant:3"), "no time-to-go input"),
        (("extrapolate", "p.onnx"), "needs its environment: --env Hopper-v5"),
        (("extrapolate", "p.onnx", "--env", "Hopper-v5"), "there is no file p.onnx"),
        (("watch", "{timed}", "--out", "p.avi"), "a film is written as .mp4, not as p.avi"),
        (("watch", "{timeless}", "--beside", "constant:3"), "no clock to set beside it"),
        (("watch", "home/set_table/place/seed-0"), "see perdure home video"),
        (("card", "{timed}", "--table", "none.parquet"), "none.parquet does not exist"),
        (("extrapolate", "."), "must hold one policy (*.safetensors), it holds none"),
    ],
)
def test_a_mistake_ends_in_one_line(perdure, files, tmp_path, arguments, message):
    names = {name: str(files / f"{name}.safetensors") for name in ("timed", "timeless")}
    line = refused(perdure(*(each.format(**names) for each in arguments), cwd=tmp_path))
    assert message in line
    assert not any(path.suffix in (".onnx", ".mp4") for path in tmp_path.iterdir())
