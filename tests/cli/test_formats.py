"""Policies go out as ONNX models, films and cards, and models of other makers come in, by command line."""

from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import onnxruntime
import pytest

from perdure.cli.parse import parse
from perdure.evaluate import watch as films
from perdure.horizon import Constant, Countdown
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


@pytest.mark.parametrize("name", ["export", "watch", "card"])
def test_each_command_is_listed_and_explains_itself(command, tmp_path, name):
    assert f"perdure {name} " in succeeded(command(cwd=tmp_path))
    assert "usage: perdure" in succeeded(command(name, "--help", cwd=tmp_path))


def test_a_policy_is_exported_and_evaluated_as_an_onnx_model(command, files, tmp_path):
    file = files / "timed.safetensors"
    assert succeeded(command("export", file, "p.onnx", "--clock", "constant:20", cwd=tmp_path)).strip() == "p.onnx"
    rows = np.random.default_rng(0).standard_normal((50, 4))
    (actions,) = onnxruntime.InferenceSession(tmp_path / "p.onnx").run(None, {"observation": rows})
    expected = load_policy(file).act(rows, np.zeros(50), Constant(20.0))
    np.testing.assert_allclose(actions, expected, atol=1e-6)
    few = ("--eval-seeds", 2, "--disturb", "none", "--on", "here", "--out", "out")
    flags = ("--env", "envpool:InvertedPendulum-v4", *few)
    assert "Report: " in succeeded(command("extrapolate", "p.onnx", *flags, "--steps", 30, cwd=tmp_path))
    frame, notes = read_table(tmp_path / "out" / "episodes.parquet")
    assert set(frame["policy"]) == {"p"}
    assert notes["command"].startswith("perdure extrapolate p.onnx --env")
    groups = set((tmp_path / "out" / "groups").iterdir())
    succeeded(command("extrapolate", "p.onnx", *flags, "--steps", 30, cwd=tmp_path))
    assert set((tmp_path / "out" / "groups").iterdir()) == groups, "nothing is run again"
    other = command("extrapolate", "p.onnx", *flags, "--steps", 20, cwd=tmp_path)
    assert other.returncode == 2
    assert "another evaluation" in other.stderr
    assert set((tmp_path / "out" / "groups").iterdir()) == groups, "nothing finished is replaced"


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (("--normalizer", "n.pkl"), "--normalizer: only for Stable-Baselines3 models"),
        (("--time-feature=linear:1000", "--trust"), "--time-feature, --trust: only for Stable-Baselines3 models"),
        ((), "there is no file p.onnx"),
    ],
)
def test_a_flag_that_means_nothing_to_an_onnx_model_is_refused(command, tmp_path, flags, message):
    line = refused(command("extrapolate", "p.onnx", "--env", "Pendulum-v1", *flags, cwd=tmp_path))
    assert message in line


def test_the_clock_default_is_the_policys_own(command, files, tmp_path):
    succeeded(command("export", files / "timed.safetensors", "own.onnx", "--clock", "default", cwd=tmp_path))
    model = onnxruntime.InferenceSession(tmp_path / "own.onnx")
    assert model.get_modelmeta().custom_metadata_map["perdure.clock"] == "constant(50)"


def test_the_ending_of_an_onnx_model_may_be_written_in_capitals(command, files, tmp_path):
    assert succeeded(command("export", files / "timeless.safetensors", "P.ONNX", cwd=tmp_path)) == "P.ONNX\n"
    assert onnxruntime.InferenceSession(tmp_path / "P.ONNX").get_inputs()[0].name == "observation"


def test_films_know_the_clocks_default_and_countdown(command, files, monkeypatch, tmp_path):
    filmed = []

    def watch(policy, out, *, clock, beside, **options):
        filmed.append((clock, beside))
        return SimpleNamespace(sentences=[], world="", path=out)

    monkeypatch.setattr(films, "watch", watch)
    clocks = ("--clock", "default", "--beside", "countdown", "--steps", 70)
    succeeded(command("watch", files / "timed.safetensors", *clocks, cwd=tmp_path))
    assert filmed == [(Constant(50.0), Countdown(70.0))]


def test_a_card_lies_beside_the_policy(command, files, tmp_path):
    (tmp_path / "shared").mkdir()
    (tmp_path / "shared" / "policy.safetensors").write_bytes((files / "timed.safetensors").read_bytes())
    flags = ("--steps", 30, "--eval-seeds", 2, "--disturb", "none", "--on", "here", "--out", "out")
    succeeded(command("extrapolate", "shared", *flags, cwd=tmp_path))
    for table in ("out/episodes.parquet", "out"):
        path = succeeded(command("card", "shared", "--table", table, cwd=tmp_path)).strip()
        assert path == "shared/README.md"
        assert "# timed on InvertedPendulum-v4" in (tmp_path / path).read_text()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("export", "{timed}", "p.txt"), "out must be a file named .onnx, not p.txt"),
        (("export", "{timed}", "p.onnx", "--clock", "never:3"), "unknown Clock 'never'"),
        (("export", "{timeless}", "p.onnx", "--clock", "constant:3"), "no time-to-go input"),
        (("export", "{timed}", "p.onnx", "--clock", "countdown"), "a clock is written name:steps"),
        (("export", "{timeless}", "p.onnx", "--clock", "default"), "--clock default: this InvertedPendulum-v4 policy"),
        (("watch", "{timeless}", "--beside", "default"), "--beside default: this InvertedPendulum-v4 policy has no"),
        (("extrapolate", "P.ONNX"), "needs its environment: --env Hopper-v5"),
        (("extrapolate", "p.onnx"), "needs its environment: --env Hopper-v5"),
        (("extrapolate", "p.onnx", "--env", "Hopper-v5"), "there is no file p.onnx"),
        (
            ("watch", "{timed}", "--env", "Hopper-v5"),
            "other policies take none",
        ),
        (("watch", "{timed}", "--out", "p.avi"), "a film is written as .mp4, .gif, .webp, not as p.avi"),
        (("watch", "{timeless}", "--beside", "constant:3"), "takes no clock"),
        (("watch", "home/set_table/place/seed-0"), "see perdure home video"),
        (("card", "{timed}", "--table", "none.parquet"), "none.parquet does not exist"),
        (("extrapolate", "."), "must hold one policy (*.safetensors), it holds none"),
    ],
)
def test_a_mistake_ends_in_one_line(command, files, tmp_path, arguments, message):
    names = {name: str(files / f"{name}.safetensors") for name in ("timed", "timeless")}
    line = refused(command(*(each.format(**names) for each in arguments), cwd=tmp_path))
    assert message in line
    assert not any(path.suffix in (".onnx", ".mp4") for path in tmp_path.iterdir())


@dataclass(frozen=True)
class Inner:
    total_steps: int = 5


@dataclass(frozen=True)
class Flags:
    out: Path = Path("out")
    name: str = ""
    steps: int = 1
    seeds: tuple[int, ...] = (0,)
    cores: int | None = None
    rate: float = 1.0
    inner: Inner = field(default_factory=Inner)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (["--steps", "1e5"], Flags(steps=100_000)),
        (["--steps=1e5"], Flags(steps=100_000)),
        (["--seeds", "1e1", "2", "3"], Flags(seeds=(10, 2, 3))),
        (["--cores", "1e1"], Flags(cores=10)),
        (["--inner.total-steps", "1e6"], Flags(inner=Inner(1_000_000))),
        (["--inner.total_steps=1e6"], Flags(inner=Inner(1_000_000))),
        (["--out", "1e2"], Flags(out=Path("1e2"))),
        (["--name", "5e2"], Flags(name="5e2")),
        (["--steps", "7", "--rate", "1e2"], Flags(steps=7, rate=100.0)),
    ],
)
def test_only_whole_numbers_are_written_out(given, expected):
    assert parse(Flags, given, "test") == expected
