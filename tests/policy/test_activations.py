"""Activation functions against their definitions in float64, and against numbers from PyTorch 2.13."""

from __future__ import annotations

from math import erf, exp, log1p, sqrt, tanh

import numpy as np
import pytest

from perdure.policy.network import ACTIVATIONS
from perdure.policy.readers.sb3 import TORCH_ACTIVATIONS

DEFINITIONS = {
    "relu": lambda x: max(x, 0.0),
    "tanh": tanh,
    "elu": lambda x: x if x > 0 else exp(x) - 1,
    "selu": lambda x: 1.0507009873554805 * (x if x > 0 else 1.6732632423543772 * (exp(x) - 1)),
    "leaky_relu": lambda x: x if x > 0 else 0.01 * x,
    "sigmoid": lambda x: 1 / (1 + exp(-x)),
    "silu": lambda x: x / (1 + exp(-x)),
    "gelu": lambda x: x * (1 + erf(x / sqrt(2))) / 2,
    "softplus": lambda x: log1p(exp(x)),
    "mish": lambda x: x * tanh(log1p(exp(x))),
}
PYTORCH = {
    "relu": (0.0, 0.699999988079071),
    "tanh": (-0.9051482677459717, 0.6043677926063538),
    "elu": (-0.7768698334693909, 0.699999988079071),
    "selu": (-1.3658143281936646, 0.7354906797409058),
    "leaky_relu": (-0.014999999664723873, 0.699999988079071),
    "sigmoid": (0.18242552876472473, 0.6681877374649048),
    "silu": (-0.2736382782459259, 0.46773141622543335),
    "gelu": (-0.10021086037158966, 0.5306254625320435),
    "softplus": (0.20141328871250153, 1.103186011314392),
    "mish": (-0.2980997562408447, 0.5611483454704285),
}
"""`torch.nn.functional.NAME(torch.tensor([-1.5, 0.7]))`."""


def apply(name, values):
    return ACTIVATIONS[name](np.array(values, np.float32))


def test_every_function_is_tested():
    assert set(DEFINITIONS) == set(PYTORCH) == set(ACTIVATIONS)


@pytest.mark.parametrize("name", ACTIVATIONS)
def test_values_are_those_of_the_definition(name):
    x = np.concatenate([np.linspace(-12, 12, 1001), [0.0, 1e-6, -1e-6, 30.0, -30.0]]).astype(np.float32)
    expected = [DEFINITIONS[name](float(each)) for each in x]
    np.testing.assert_allclose(apply(name, x), expected, rtol=1e-6, atol=2e-7)


@pytest.mark.parametrize("name", ACTIVATIONS)
def test_values_are_those_of_pytorch(name):
    np.testing.assert_allclose(apply(name, [-1.5, 0.7]), PYTORCH[name], rtol=0, atol=1.2e-7)


@pytest.mark.parametrize("name", ACTIVATIONS)
def test_large_values_give_no_warning_and_stay_finite(name):
    values = apply(name, [-1e30, -1e4, -100.0, 100.0, 1e4, 1e30])
    assert values.dtype == np.float32
    assert np.isfinite(values).all()


@pytest.mark.parametrize("name", ACTIVATIONS)
def test_an_entry_does_not_depend_on_its_place(name):
    x = np.random.default_rng(0).normal(scale=3, size=(64, 33)).astype(np.float32)
    whole = apply(name, x)
    for start in range(0, 40, 7):
        part = np.ascontiguousarray(x[start : start + 5, 3:16])
        np.testing.assert_array_equal(apply(name, part), whole[start : start + 5, 3:16])


def test_every_activation_is_read_from_models_of_pytorch():
    assert set(TORCH_ACTIVATIONS.values()) == set(ACTIVATIONS)
