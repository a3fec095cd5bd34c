"""The protocol: what it appends, what it refuses, and that it survives JSON."""

import itertools
import json
from dataclasses import FrozenInstanceError, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from perdure.errors import PerdureError
from perdure.horizon import Constant, Fixed, Geometric, HorizonProtocol, Infinite, Linear, Uniform

THESIS = HorizonProtocol(Geometric(10), Uniform(200, 1000), "terminated", gamma=1.0, normalizer_gamma=0.99)
BLIND = HorizonProtocol(None, Fixed(1000), "truncated", gamma=0.99, normalizer_gamma=0.99)


@pytest.mark.parametrize(
    "parts",
    list(
        itertools.product(
            [None, Linear(), Geometric(5), Geometric(3, low=0.0, high=0.5)],
            [Fixed(200), Uniform(200, 1000), Infinite()],
            ["terminated", "truncated"],
            [0.0, 0.98, 1.0],
        )
    ),
    ids=str,
)
def test_a_protocol_survives_json_text(parts):
    protocol = HorizonProtocol(*parts, normalizer_gamma=0.995, normalize_embedding=parts[0] is not None)
    assert HorizonProtocol.from_json(json.loads(json.dumps(protocol.to_json(), allow_nan=False))) == protocol


def test_the_stored_form_is_what_policy_files_hold():
    assert THESIS.to_json() == {
        "embedding": {"name": "geometric", "size": 10, "low": 0.99, "high": 1.0},
        "horizon": {"name": "uniform", "low": 200, "high": 1000},
        "end": "terminated",
        "gamma": 1.0,
        "normalizer_gamma": 0.99,
        "normalize_embedding": False,
    }


def test_phi_has_the_embedding_size_and_none_without_an_embedding():
    elapsed, horizons = np.arange(4.0), np.full(4, 8.0)
    assert THESIS.embedding_size == 10
    assert np.array_equal(THESIS.embed(elapsed, horizons), Geometric(10)(elapsed, horizons))
    assert BLIND.embedding_size == 0
    assert BLIND.embed(elapsed, horizons).shape == (4, 0)
    assert jax.jit(BLIND.embed)(jnp.asarray(elapsed), jnp.asarray(horizons)).shape == (4, 0)


def test_without_an_embedding_an_infinite_horizon_is_no_trouble():
    assert BLIND.embed(np.array([3.0]), np.array([np.inf])).shape == (1, 0)


def test_a_protocol_does_not_change():
    with pytest.raises(FrozenInstanceError):
        THESIS.gamma = 0.5


def test_undiscounted_bootstrapping_is_legal_even_without_end():
    assert replace(BLIND, gamma=1.0, horizon=Infinite()).gamma == 1


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"gamma": 1.01}, r"gamma must be a number in \[0, 1\], got 1.01"),
        ({"gamma": -0.1}, r"gamma must be a number in \[0, 1\], got -0.1"),
        ({"gamma": "0.9"}, r"gamma must be a number in \[0, 1\], got '0.9'"),
        ({"normalizer_gamma": float("nan")}, r"normalizer_gamma must be a number in \[0, 1\], got nan"),
        ({"end": "done"}, "end must be one of terminated, truncated, got 'done'"),
        ({"end": ["terminated"]}, "end must be one of terminated, truncated"),
        ({"embedding": Geometric}, "embedding must be an Embedding"),
        ({"embedding": Constant(5)}, "embedding must be an Embedding"),
        ({"horizon": 1000}, "horizon must be a HorizonDistribution, such as .*, got 1000"),
        ({"normalize_embedding": "no"}, "normalize_embedding must be True or False, got 'no'"),
        ({"embedding": None, "normalize_embedding": True}, "normalize_embedding needs an embedding"),
    ],
)
def test_a_contradiction_is_refused_with_a_sentence(change, sentence):
    with pytest.raises(PerdureError, match=sentence):
        replace(THESIS, **change)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"embedding": {"name": "fourier"}}, "unknown Embedding 'fourier'; the known ones are geometric, linear"),
        ({"embedding": "linear"}, "unknown Embedding 'linear'"),
        ({"embedding": {"name": ["linear"]}}, "unknown Embedding"),
        ({"embedding": {"size": 5}}, "unknown Embedding None"),
        ({"embedding": {"name": "geometric", "size": 10.5}}, "size must be"),
        ({"embedding": {"name": "geometric", "color": 1}}, "Embedding 'geometric' cannot be built from"),
        (
            {"horizon": {"name": "poisson"}},
            "unknown HorizonDistribution 'poisson'; the known ones are fixed, infinite, uniform",
        ),
        ({"horizon": None}, "unknown HorizonDistribution None"),
        ({"horizon": {"name": "uniform", "low": 9, "high": 3}}, "must not exceed"),
        ({"horizon": {"name": "fixed", "steps": "ten"}}, "HorizonDistribution 'fixed' cannot be built from"),
        ({"gamma": 2}, "gamma must be a number"),
        ({"alpha": 2}, "cannot be read: unknown alpha"),
    ],
)
def test_an_edited_protocol_is_refused_by_name(change, sentence):
    with pytest.raises(PerdureError, match=sentence):
        HorizonProtocol.from_json({**THESIS.to_json(), **change})


def test_missing_parts_are_named():
    values = THESIS.to_json()
    del values["gamma"], values["end"]
    with pytest.raises(PerdureError, match=r"end, gamma$"):
        HorizonProtocol.from_json(values)


@pytest.mark.parametrize("values", [None, "protocol", [1, 2]])
def test_what_is_no_protocol_is_refused(values):
    with pytest.raises(PerdureError, match="table of fields"):
        HorizonProtocol.from_json(values)
