"""A policy file gives back the policy that was written, or says in a sentence why it cannot."""

from __future__ import annotations

import json
import pickle
import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make_policy import random_policy
from safetensors.numpy import save

from perdure.errors import PerdureError
from perdure.horizon import Geometric, Periodic
from perdure.policy import load_policy, save_policy
from perdure.policy.files import LABELS, shipped_policies

KINDS = [
    {"embedding": "geometric"},
    {"embedding": "linear", "activation": "relu", "hidden": (4,)},
    {"embedding": None},
    {"normalize_embedding": True},
]


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """The bytes of one policy, and a place to put others."""
    path = tmp_path_factory.mktemp("policies") / "policy.safetensors"
    save_policy(random_policy(hidden=(4,)), path)
    return path.read_bytes(), path.with_name("other.safetensors")


def refused(path, data):
    path.write_bytes(data)
    with pytest.raises(PerdureError, match=path.name):
        load_policy(path)


def loaded_or_refused(path):
    try:
        return load_policy(path)
    except PerdureError as error:
        return error


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_loaded_is_what_was_saved_bit_for_bit(kind, tmp_path):
    policy = random_policy(**kind)
    loaded = load_policy(save_policy(policy, tmp_path / "p"))
    assert set(loaded.weights) == set(policy.weights)
    for name, weight in policy.weights.items():
        assert (loaded.weights[name].dtype, loaded.weights[name].tobytes()) == (weight.dtype, weight.tobytes())
    for name in ("mean", "var"):
        assert getattr(loaded.normalizer, name).tobytes() == getattr(policy.normalizer, name).tobytes()
    for name in ("task", "activation", "protocol", "clock", "provenance"):
        assert getattr(loaded, name) == getattr(policy, name)
    assert (loaded.normalizer.clip, loaded.normalizer.epsilon) == (policy.normalizer.clip, policy.normalizer.epsilon)


@pytest.mark.parametrize("kind", KINDS)
def test_a_loaded_policy_acts_bit_for_bit_as_the_one_that_was_saved(kind, tmp_path):
    policy = random_policy(**kind)
    rows = np.random.default_rng(0).normal(size=(7, 11))
    loaded = load_policy(save_policy(policy, tmp_path / "p"))
    np.testing.assert_array_equal(loaded.act(rows, np.arange(7.0)), policy.act(rows, np.arange(7.0)))


def test_the_same_policy_gives_the_same_bytes_however_often_and_in_whatever_order_it_is_built(tmp_path):
    first = save_policy(random_policy(), tmp_path / "a").read_bytes()
    turned = random_policy()
    turned = random_policy(weights=dict(reversed(turned.weights.items())))
    assert save_policy(turned, tmp_path / "b").read_bytes() == first
    assert save_policy(load_policy(tmp_path / "a"), tmp_path / "c").read_bytes() == first
    assert save_policy(random_policy(seed=1), tmp_path / "d").read_bytes() != first


def test_a_file_that_is_not_there_is_not_found(tmp_path):
    with pytest.raises(PerdureError, match="none"):
        load_policy(tmp_path / "none")


def test_a_shipped_policy_is_found_by_its_name_and_a_near_name_is_offered():
    assert load_policy("Hopper-v3/geometric").task.name == "Hopper-v3"
    assert load_policy("home/set_table/place/seed-0").task.name.startswith("perdure/HomePlace-v0")
    with pytest.raises(PerdureError, match="'Hopper-v3/geometric'"):
        load_policy("Hopper-v3/geometrik")


def test_a_file_without_its_ending_is_offered_and_a_zip_is_told_how_to_be_read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ppo1.zip").write_bytes(b"PK\x03\x04, a zip archive")
    with pytest.raises(PerdureError, match=r"'ppo1\.zip'\?$"):
        load_policy("ppo1")
    with pytest.raises(PerdureError, match="from_sb3"):
        load_policy("ppo1.zip")


def test_a_label_speaks_of_a_policy_that_is_shipped():
    locomotion = {name for name in shipped_policies() if not name.startswith("home/")}
    assert set(LABELS) == locomotion


def test_a_folder_is_refused(tmp_path):
    with pytest.raises(PerdureError, match="folder"):
        load_policy(tmp_path)


@given(data=st.data())
@settings(max_examples=60, deadline=None)
def test_a_file_cut_off_anywhere_is_refused(saved, data):
    whole, path = saved
    refused(path, whole[: data.draw(st.integers(0, len(whole) - 1))])


@given(data=st.data())
@settings(max_examples=120, deadline=None)
def test_a_file_with_any_byte_edited_is_refused(saved, data):
    whole, path = saved
    position, change = data.draw(st.integers(0, len(whole) - 1)), data.draw(st.integers(1, 255))
    edited = bytearray(whole)
    edited[position] ^= change
    path.write_bytes(edited)
    found = loaded_or_refused(path)
    if isinstance(found, PerdureError):
        assert path.name in str(found)
    else:
        # Only what carries no meaning may change: the header's blanks and the order of its keys.
        assert save_policy(found, path).read_bytes() == whole


def test_appended_bytes_are_refused(saved):
    whole, path = saved
    refused(path, whole + b"\0")


class _Bomb:
    def __reduce__(self):
        return (pytest.fail, ("loading a policy ran code",))


def _header(text, tail=b""):
    return struct.pack("<Q", len(text)) + text + tail


FOREIGN = {
    "empty": b"",
    "seven bytes": b"perdure",
    "text": b"This is not a policy.\n" * 100,
    "pickle": pickle.dumps(_Bomb()),
    "zip": b"PK\x03\x04" + bytes(200),
    "another safetensors file": save({"x": np.zeros(3, np.float32)}),
    "a header of null": _header(b"null"),
    "a header of a list": _header(b"[1, 2]"),
    "a header of a long number": _header(b"1" * 10_000),
    "a header nested too deep": _header(b"[" * 200_000),
    "metadata of null": _header(b'{"__metadata__": null}'),
    "metadata of a list": _header(b'{"__metadata__": ["perdure.policy"]}'),
    "numbers as metadata": _header(b'{"__metadata__": {"perdure.policy": 1, "sha256": 2}}'),
    "a header in another encoding": _header("{}".encode("utf-16")),
    "numbers NumPy does not have": _header(b'{"x": {"dtype": "BF16", "shape": [1], "data_offsets": [0, 2]}}', b"\0\0"),
    "a header larger than the file": struct.pack("<Q", 2**63) + b"{}",
    "a header larger than any policy's": struct.pack("<Q", 2**40) + bytes(1000),
}


@pytest.mark.parametrize("data", FOREIGN.values(), ids=FOREIGN)
def test_a_foreign_file_is_refused(saved, data):
    refused(saved[1], data)


def test_a_foreign_file_larger_than_the_memory_is_refused_without_being_read(tmp_path):
    path = tmp_path / "huge.safetensors"
    header = b'{"x": {"dtype": "U8", "shape": [1099511627776], "data_offsets": [0, 1099511627776]}}'
    with path.open("wb") as file:
        file.write(_header(header))
        file.truncate(8 + len(header) + 2**40)  # a hole: it takes no space
    with pytest.raises(PerdureError, match=r"huge\.safetensors"):
        load_policy(path)


def forged(whole, change):
    """The file with its description changed and its checksum made to fit, as a careful forger would."""
    import hashlib

    (size,) = struct.unpack("<Q", whole[:8])
    header = json.loads(whole[8 : 8 + size])
    description = json.loads(header["__metadata__"]["perdure.policy"])
    change(description)
    text = json.dumps(description)
    digest = hashlib.sha256(text.encode())
    dtypes = {"F32": "<f4", "F64": "<f8"}
    for name in sorted(set(header) - {"__metadata__"}):
        entry = header[name]
        begin, end = (8 + size + offset for offset in entry["data_offsets"])
        digest.update(f"{name} {dtypes[entry['dtype']]} {tuple(entry['shape'])}".encode() + whole[begin:end])
    header["__metadata__"] = {"perdure.policy": text, "sha256": digest.hexdigest()}
    return _header(json.dumps(header).encode(), whole[8 + size :])


def test_the_forger_of_these_tests_can_make_a_file_that_loads(saved):
    whole, path = saved
    path.write_bytes(forged(whole, lambda description: description["provenance"].update(seed=7)))
    assert load_policy(path).provenance["seed"] == 7


def test_a_file_of_version_1_is_read_which_knew_neither_scale_nor_reference(saved):
    def older(description):
        description.update(version=1)
        assert (description.pop("return_scale"), description.pop("reference")) == (None, None)

    whole, path = saved
    path.write_bytes(forged(whole, older))
    assert save_policy(load_policy(path), path).read_bytes() == whole


def forged_array(whole, name, change):
    """The file with the numbers of one of its arrays changed and its checksum made to fit."""
    import hashlib

    (size,) = struct.unpack("<Q", whole[:8])
    header, body = json.loads(whole[8 : 8 + size]), bytearray(whole[8 + size :])
    dtypes = {"F32": "<f4", "F64": "<f8", "I64": "<i8", "BOOL": "|b1"}
    begin, end = header[name]["data_offsets"]
    numbers = np.frombuffer(bytes(body[begin:end]), dtypes[header[name]["dtype"]]).copy()
    change(numbers)
    body[begin:end] = numbers.tobytes()
    digest = hashlib.sha256(header["__metadata__"]["perdure.policy"].encode())
    for each in sorted(set(header) - {"__metadata__"}):
        entry = header[each]
        part = body[slice(*entry["data_offsets"])]
        digest.update(f"{each} {dtypes[entry['dtype']]} {tuple(entry['shape'])}".encode() + part)
    header["__metadata__"]["sha256"] = digest.hexdigest()
    return _header(json.dumps(header).encode(), bytes(body))


def put(value, every=False):
    def change(numbers):
        numbers[: None if every else 1] = value

    return change


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("policy.0.weight", put(np.nan)),
        ("policy.0.weight", put(np.inf)),
        ("policy.1.bias", put(-np.inf)),
        ("value.0.weight", put(np.nan)),
        ("policy.0.weight", put(3e38, every=True)),
        ("log_std", put(np.nan)),
        ("normalizer.mean", put(np.nan)),
        ("normalizer.var", put(-1.0)),
        ("normalizer.var", put(np.inf)),
    ],
)
def test_numbers_that_no_policy_can_act_with_are_refused_though_the_checksum_fits(saved, name, change):
    whole, path = saved
    path.write_bytes(forged_array(whole, name, lambda numbers: None))
    load_policy(path)
    refused(path, forged_array(whole, name, change))


def deep(levels):
    value = 1
    for _ in range(levels):
        value = [value]
    return value


FORGERIES = {
    "no version": lambda d: d.pop("version"),
    "text as version": lambda d: d.update(version="1"),
    "clip of zero": lambda d: d["normalizer"].update(clip=0.0),
    "negative clip": lambda d: d["normalizer"].update(clip=-10.0),
    "infinite clip": lambda d: d["normalizer"].update(clip=np.inf),
    "epsilon of zero": lambda d: d["normalizer"].update(epsilon=0.0),
    "low above high": lambda d: d["task"].update(action_low=[2.0] * 3),
    "nan as a bound": lambda d: d["task"].update(action_high=[np.nan] * 3),
    "text as bounds": lambda d: d["task"].update(action_low=["-1"] * 3),
    "a number as task": lambda d: d["task"].update(name=3),
    "an escape in the task": lambda d: d["task"].update(name="Hopper\x1b[2J"),
    "a long task": lambda d: d["task"].update(name="H" * 10_000),
    "a lone surrogate": lambda d: d["task"].update(name="\ud800"),
    "null as seed": lambda d: d["provenance"].update(seed=None),
    "text as seed": lambda d: d["provenance"].update(seed="zero"),
    "a huge seed": lambda d: d["provenance"].update(seed=10**30),
    "a number as method": lambda d: d["provenance"].update(method=1),
    "deep provenance": lambda d: d["provenance"].update(deep=deep(900)),
    "a huge horizon": lambda d: d["protocol"].update(horizon={"name": "fixed", "steps": 10**400}),
    "true as horizon": lambda d: d["protocol"].update(horizon={"name": "fixed", "steps": True}),
    "text as clock": lambda d: d["clock"].update(steps="500"),
    "a list as embedding": lambda d: d["protocol"].update(embedding=["geometric"]),
    "a number as activation": lambda d: d.update(activation=["tanh"]),
    "negative return scale": lambda d: d.update(return_scale=-1.0),
    "a reference that is not there": lambda d: d.update(reference={"horizon": 1000}),
    "version": lambda d: d.update(version=4),
    "activation": lambda d: d.update(activation="cosine"),
    "missing": lambda d: d.pop("task"),
    "size": lambda d: d["task"].update(observation_size=12),
    "box": lambda d: d["task"].update(action_low=[-1.0] * 2),
    "embedding": lambda d: d["protocol"].update(embedding={"name": "os.system"}),
    "clock": lambda d: d.update(clock={"name": "constant", "steps": -1}),
    "no clock": lambda d: d.update(clock=None),
    "normalizer": lambda d: d["normalizer"].update(center=1),
    "provenance": lambda d: d.update(provenance=[1]),
    "not a table": lambda d: d.update(task=3),
}


@pytest.mark.parametrize("change", FORGERIES.values(), ids=FORGERIES)
def test_a_file_whose_description_makes_no_sense_is_refused_though_its_checksum_fits(saved, change):
    whole, path = saved
    refused(path, forged(whole, change))


def test_what_could_not_be_read_is_not_written(tmp_path):
    odd = random_policy(provenance={"method": "a\x1b[31m", "seed": 0})
    with pytest.raises(PerdureError, match=r"provenance\.method"):
        save_policy(odd, tmp_path / "p")
    assert not (tmp_path / "p").exists()


def test_a_pipe_is_refused_without_waiting_for_it(tmp_path):
    import os

    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(PerdureError, match="no regular file"):
        load_policy(tmp_path / "pipe")


class TestPartsThatDoNotFit:
    @pytest.mark.parametrize(
        "parts",
        [
            {"weights": {}},
            {"activation": "cosine"},
            {"clock": None},
            {"embedding": None, "clock": Periodic(100.0)},
            {"normalizer": random_policy(normalize_embedding=True).normalizer},
            {"protocol": random_policy(embedding="linear").protocol},
            {"weights": {k: v for k, v in random_policy().weights.items() if not k.startswith("policy.2")}},
            {"weights": {k: v for k, v in random_policy().weights.items() if not k.startswith("value.2")}},
            {"weights": random_policy().weights | {"policy.1.weight": np.zeros((9, 8), np.float32)}},
            {"weights": random_policy().weights | {"policy.2.bias": np.zeros(4, np.float32)}},
        ],
        ids=lambda parts: "-".join(parts),
    )
    def test_are_refused_when_the_policy_is_built(self, parts):
        with pytest.raises(PerdureError):
            random_policy(**parts)

    def test_are_named(self):
        wide = random_policy().protocol.__class__(
            Geometric(10), random_policy().protocol.horizon, "terminated", 1.0, 1.0
        )
        with pytest.raises(PerdureError, match=r"Hopper-v3.*16.*11.*10.*21"):
            random_policy(protocol=wide)


def test_a_policy_without_its_critic_acts_the_same_and_says_why_it_has_no_value(tmp_path):
    whole = random_policy(hidden=(32, 32))
    larger, smaller = (save_policy(each, tmp_path / str(each.has_critic)) for each in (whole, whole.without_critic()))
    alone = load_policy(smaller)
    observations, zeros = np.ones((3, whole.task.observation_size)), np.zeros(3)
    np.testing.assert_array_equal(alone.act(observations, zeros), whole.act(observations, zeros))
    assert [each.has_critic for each in (whole, alone)] == [True, False]
    assert smaller.stat().st_size < larger.stat().st_size
    with pytest.raises(PerdureError, match="critic"):
        alone.scaled_value(observations, zeros, zeros + 10)


def test_a_halved_policy_is_half_as_large_and_acts_within_the_precision_of_16_bits(tmp_path):
    whole = random_policy(hidden=(64, 64))
    short = load_policy(save_policy(whole.halved(), tmp_path / "short"))
    long = save_policy(whole, tmp_path / "long")
    assert (tmp_path / "short").stat().st_size < 0.6 * long.stat().st_size
    observations, zeros = np.random.default_rng(0).standard_normal((50, whole.task.observation_size)), np.zeros(50)
    given, exact = short.act(observations, zeros), whole.act(observations, zeros)
    np.testing.assert_allclose(given, exact, atol=0.02)
    assert (given != exact).any()
    np.testing.assert_array_equal(given, short.halved().act(observations, zeros))
    large = {**whole.weights, "policy.0.bias": np.full_like(whole.weights["policy.0.bias"], 1e6)}
    with pytest.raises(PerdureError, match=r"policy\.0\.bias.*16 bits"):
        replace(whole, weights=large).halved()
