"""Squashed outputs against numbers worked out by hand, and in files that other readers must not misread."""

from __future__ import annotations

import json
from dataclasses import replace
from math import tanh

import numpy as np
import pytest
from make_policy import random_policy

from perdure.errors import PerdureError
from perdure.policy import TaskInfo, load_policy, save_policy
from perdure.policy.files import shipped_policies
from perdure.policy.policy import TanhSquash

LOW, HIGH = np.array([-2.0, 0.0]), np.array([2.0, 10.0])
WIDE = TaskInfo("Hopper-v3", 11, (-2.0, 0.0, -1.0), (2.0, 10.0, 1.0))


def squash(outputs, **options):
    return TanhSquash(**options)(np.array(outputs, np.float32), LOW, HIGH)


def test_outputs_are_stretched_to_the_box():
    # tanh(0) = 0 is the middle of the box; atanh(0.5) = 0.5493061443 is three quarters of the way up.
    np.testing.assert_allclose(squash([[0.0, 0.0], [0.5493061443, -0.5493061443]]), [[0.0, 5.0], [1.0, 2.5]], atol=1e-6)


def test_large_outputs_end_at_the_bounds():
    assert squash([[1e9, -1e9]]).tolist() == [[2.0, 0.0]]


def test_the_limit_cuts_before_tanh():
    np.testing.assert_allclose(squash([[50.0, -50.0]], limit=2.0), [[2 * tanh(2), 5 - 5 * tanh(2)]], atol=1e-6)


@pytest.mark.parametrize("limit", [0, -1.0, float("nan"), "2"])
def test_a_limit_that_is_no_positive_number_is_refused(limit):
    with pytest.raises(PerdureError, match=f"got {limit!r}"):
        TanhSquash(limit)


@pytest.mark.parametrize(
    "values", [None, 3, {"name": "tanh"}, {"name": "sine", "limit": 1.0}, {"name": "tanh", "x": 1}]
)
def test_a_description_of_something_else_is_refused(values):
    with pytest.raises(PerdureError, match="squashing"):
        TanhSquash.from_json(values)


@pytest.mark.parametrize("squashing", [TanhSquash(), TanhSquash(2.0)])
def test_a_policy_keeps_its_squashing_in_its_file(squashing, tmp_path):
    clipped = random_policy(task=WIDE)
    policy = replace(clipped, squash=squashing)
    loaded = load_policy(save_policy(policy, tmp_path / "policy"))
    assert loaded.squash == squashing
    rows = np.random.default_rng(0).normal(size=(20, 11))
    actions = policy.act(rows, np.zeros(20))
    np.testing.assert_array_equal(loaded.act(rows, np.zeros(20)), actions)
    assert (actions > WIDE.action_low).all()
    assert (actions < WIDE.action_high).all()
    assert np.abs(actions - clipped.act(rows, np.zeros(20))).max() > 0.1


def test_an_older_reader_refuses_a_squashed_policy_by_its_version(tmp_path):
    """It would cut the output instead. It reads the files of all other policies as before."""
    versions = {}
    for squashing in (None, TanhSquash()):
        path = save_policy(replace(random_policy(), squash=squashing), tmp_path / "policy")
        header = path.read_bytes()[8:].split(b"}}", 1)[0]
        versions[squashing is None] = json.loads(
            json.loads(b'"' + header.split(b'"perdure.policy": "')[1].split(b'", "')[0] + b'"')
        )
    assert versions[True]["version"] == 2
    assert "squash" not in versions[True]
    assert versions[False]["version"] == 3


def test_a_squashed_output_needs_finite_bounds():
    endless = TaskInfo("Hopper-v3", 11, (-np.inf,) * 3, (np.inf,) * 3)
    with pytest.raises(PerdureError, match="bounds"):
        replace(random_policy(task=endless), squash=TanhSquash())


LOCOMOTION = {name: path for name, path in shipped_policies().items() if not name.startswith("home/")}


@pytest.mark.parametrize("name", LOCOMOTION)
def test_a_shipped_policy_saved_again_has_the_same_bytes(name, tmp_path):
    again = save_policy(load_policy(LOCOMOTION[name]), tmp_path / "again")
    assert again.read_bytes() == LOCOMOTION[name].read_bytes()


def test_a_damaged_squashing_is_refused(tmp_path):
    path = save_policy(replace(random_policy(), squash=TanhSquash(2.0)), tmp_path / "policy")
    path.write_bytes(path.read_bytes().replace(b'\\"limit\\": 2.0', b'\\"limit\\": -.0'))
    with pytest.raises(PerdureError):
        load_policy(path)
