"""Films and stills of an exported policy on the robot of a contract."""

import numpy as np
import polars as pl
import pytest

from perdure.evaluate import Execution, Extrapolation, evaluate_files, reference
from perdure.evaluate import watch as films
from perdure.evaluate.run import read_file
from perdure.evaluate.stills import add_stills
from perdure.evaluate.watch import watch
from perdure.policy.onnx import model_digest
from perdure.report.page import STILLS
from tests.robots.conftest import ANT

imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
Image = pytest.importorskip("PIL.Image")


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setattr(reference, "EPISODES", 2)
    monkeypatch.setattr(reference, "STEPS", 50)
    monkeypatch.setattr(films, "RATE", 2.0)


@pytest.mark.verify
def test_a_calm_episode_is_filmed_beside_a_disturbed_one(policy_file, tmp_path):
    policy = read_file(policy_file, model_digest(policy_file), str(ANT), 50)
    film = watch(policy, tmp_path / "film.gif", disturb=["action_noise:0.5"], steps=100, size=(96, 64))
    calm, disturbed = film.sentences
    assert calm.startswith("calm, start state 0: ")
    assert disturbed == "under action_noise:0.5, start state 0: falls at step 79"  # and is filmed on
    assert film.pictures == 10  # steps of 0.05 s, a picture for ten: 1, 11, ..., 91 until a second after the fall
    with Image.open(film.path) as pictures:
        pictures.seek(7)
        shown = np.asarray(pictures.convert("RGB")).astype(int)
    left, right = shown[:, :96], shown[:, -96:]
    assert np.abs(left - right)[60:].max() > 50
    assert left[60:].std() > 10  # no black picture


def test_stills_of_an_exported_policy_show_its_fall(policy_file, tmp_path):
    out, asked = tmp_path / "out", Extrapolation((policy_file,), 100, eval_seeds=1, disturb=("push:0",), env=str(ANT))
    found = evaluate_files(asked, Execution(out, on="here", cores=1))
    add_stills(found.frame, found.files, [policy_file], out, "here")
    assert not (out / STILLS).exists()
    changed = {"outcome": pl.lit("fails silently"), "failed_step": pl.lit(10)}
    frame = found.frame.with_columns(**{name: value.cast(found.frame[name].dtype) for name, value in changed.items()})
    add_stills(frame, found.files, [policy_file], out, "here")
    assert (out / STILLS).stat().st_size > 1000
