"""Policies in folders and in the cache that Hugging Face's tools leave behind, laid out by hand as they do."""

from __future__ import annotations

import numpy as np
import pytest
from make_policy import random_policy

from perdure.errors import PerdureError
from perdure.policy import find_policy, load_policy, save_policy

COMMIT, OTHER = "a" * 40, "b" * 40


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return save_policy(random_policy(seed=5), tmp_path_factory.mktemp("one") / "policy.safetensors").read_bytes()


@pytest.fixture
def cache(tmp_path, data, monkeypatch):
    """blobs/HASH holds a file; snapshots/COMMIT/NAME is a link to it; refs/main holds the commit."""
    model = tmp_path / "hub" / "models--lab--hopper-policy"
    (model / "blobs").mkdir(parents=True)
    (model / "blobs" / "0123").write_bytes(data)
    for commit in (COMMIT, OTHER):
        (model / "snapshots" / commit).mkdir(parents=True)
    (model / "snapshots" / COMMIT / "policy.safetensors").symlink_to("../../blobs/0123")
    (model / "snapshots" / COMMIT / "README.md").write_text("a card")
    (model / "refs").mkdir()
    (model / "refs" / "main").write_text(COMMIT)
    monkeypatch.setenv("HF_HOME", str(tmp_path))
    monkeypatch.delenv("HF_HUB_CACHE", raising=False)
    return model


def same(policy):
    expected = random_policy(seed=5)
    return all(np.array_equal(policy.weights[name], expected.weights[name]) for name in expected.weights)


def test_a_folder_with_one_policy_is_that_policy(tmp_path, data):
    (tmp_path / "any-name.safetensors").write_bytes(data)
    (tmp_path / "README.md").write_text("a card")
    assert same(load_policy(tmp_path))


def test_a_downloaded_model_is_its_main_branch_by_folder_and_by_name(cache, monkeypatch, tmp_path):
    assert same(load_policy(cache))
    assert same(load_policy(cache / "snapshots" / COMMIT))
    assert find_policy("lab/hopper-policy").parent.name == COMMIT
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path / "elsewhere"))
    with pytest.raises(PerdureError, match="lab/hopper-policy"):
        find_policy("lab/hopper-policy")


def test_the_cache_is_where_hugging_faces_tools_put_it(cache, monkeypatch, tmp_path):
    (tmp_path / "huggingface").mkdir()
    (tmp_path / "huggingface" / "hub").symlink_to(cache.parent)
    monkeypatch.delenv("HF_HOME")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert find_policy("lab/hopper-policy").parent.name == COMMIT
    monkeypatch.setenv("HF_HOME", "$XDG_CACHE_HOME/huggingface")
    assert find_policy("lab/hopper-policy").parent.name == COMMIT


def test_without_a_branch_the_only_snapshot_is_taken_and_of_two_none(cache):
    (cache / "refs" / "main").unlink()
    with pytest.raises(PerdureError, match=r"2 snapshots.*main"):
        load_policy(cache)
    (cache / "snapshots" / OTHER).rmdir()
    assert same(load_policy(cache))


@pytest.mark.parametrize("content", [b"../../../../etc", b"", b"c" * 40, b"\xff\xfe\x00"])
def test_a_branch_that_points_elsewhere_is_not_followed(cache, content):
    (cache / "refs" / "main").write_bytes(content)
    with pytest.raises(PerdureError, match="2 snapshots"):
        load_policy(cache)


def test_a_folder_without_a_policy_or_with_several_is_refused(tmp_path, data):
    with pytest.raises(PerdureError, match="none"):
        load_policy(tmp_path)
    for name in ("run-2/b.zip", "run-1/a.safetensors", "other/notes.txt"):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).touch()
    with pytest.raises(PerdureError, match=r"run-1, run-2$"):
        load_policy(tmp_path)
    for name in ("a", "b"):
        (tmp_path / f"{name}.safetensors").write_bytes(data)
    with pytest.raises(PerdureError, match=r"a\.safetensors, b\.safetensors"):
        load_policy(tmp_path)


def test_a_folder_of_training_runs_with_the_name_of_a_shipped_policy_is_told_apart(tmp_path, data, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "Hopper-v3" / "geometric" / "seed-0").mkdir(parents=True)
    with pytest.raises(PerdureError, match="shipped policy"):
        find_policy("Hopper-v3/geometric")
    (tmp_path / "Hopper-v3" / "geometric" / "policy.safetensors").write_bytes(data)
    assert same(load_policy("Hopper-v3/geometric"))


def test_a_shipped_name_is_not_looked_for_in_the_cache(cache):
    fake = cache.parent / "models--Hopper-v3--geometric" / "snapshots" / COMMIT
    fake.mkdir(parents=True)
    assert "shipped" in find_policy("Hopper-v3/geometric").parts
