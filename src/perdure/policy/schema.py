"""Schema of policy files: the description, and the arrays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perdure.policy.activations import ACTIVATIONS
from perdure.policy.network import LARGEST_INPUT
from perdure.schema import Anything, Choice, Items, Maybe, Real, Rule, SchemaError, Table, Text, Whole

VERSIONS = (1, 2, 3)
LONGEST_HORIZON = 100_000_000
"""Steps of a reference episode."""

TASK = Table(
    {
        "name": Text(shortest=1),
        "observation_size": Whole(1, 1_000_000),
        "action_low": Items(Real(infinite=True), shortest=1),
        "action_high": Items(Real(infinite=True), shortest=1),
    },
    rules=(
        Rule(
            "action_low and action_high must have the same length, and no low above its high",
            lambda of: (
                len(of("action_low")) != len(of("action_high"))
                or any(low > high for low, high in zip(of("action_low"), of("action_high"), strict=True))
            ),
        ),
    ),
)
PROVENANCE = Table(
    {},
    optional={
        "method": Text(shortest=1),
        "seed": Whole(0),
        "preset": Text(),
        "engine": Text(),
        "command": Text(10_000, lines=True),
    },
    others=Anything(),
)
DESCRIPTION = Table(
    {
        "version": Whole(min(VERSIONS), max(VERSIONS)),
        "task": TASK,
        "activation": Choice(tuple(ACTIVATIONS)),
        "normalizer": Table(
            {"clip": Real(0.0, LARGEST_INPUT, above=True), "epsilon": Real(0.0, 1.0, above=True)},
        ),
        "protocol": Anything(),
        "clock": Anything(),
        "provenance": PROVENANCE,
    },
    optional={
        "return_scale": Maybe(Real(0.0, above=True)),
        "reference": Maybe(Table({"horizon": Whole(1, LONGEST_HORIZON)})),
        "squash": Table({"name": Choice(("tanh",)), "limit": Maybe(Real(0.0, above=True))}),
    },
)
"""Protocol and clock are checked by `perdure.horizon`, which knows what embeddings, clocks and distributions there are.
"""

ARRAYS: Mapping[str, tuple[str, Real | None]] = {
    "normalizer.mean": ("f8", Real()),
    "normalizer.var": ("f8", Real(0.0)),
    "reference.rewards": ("f8", Real()),
    "reference.lengths": ("i8", None),
    "reference.terminated": ("b1", None),
    "reference.observation_low": ("f8", Real()),
    "reference.observation_high": ("f8", Real()),
}
"""Name of an array to its type and the range of its numbers; every other array holds weights."""
WEIGHTS = ("f2", "f4")
"""Types of weights."""


def check_arrays(arrays: Mapping[str, NDArray[Any]]) -> None:
    """Check types and numbers of a file's arrays; shapes are checked where policy and reference are built.

    Raises:
        SchemaError: With the name of the array.
    """
    for name, array in arrays.items():
        kind, numbers = ARRAYS.get(name, (array.dtype.str[1:], None))
        weights = name not in ARRAYS
        if (weights and kind not in WEIGHTS) or array.dtype.str[1:] != kind:
            allowed = " or ".join(WEIGHTS) if weights else kind
            raise SchemaError(f"{name} must hold numbers of the type {allowed}, not {array.dtype.str[1:]}")
        if weights and not np.isfinite(array).all():
            raise SchemaError(f"{name} holds numbers that are not finite")
        if numbers is not None:
            numbers.check_many(array.ravel().tolist(), name)
