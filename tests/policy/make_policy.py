"""Policies with random weights, for tests."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from perdure.horizon import Constant, Fixed, Geometric, HorizonProtocol, Linear, Uniform
from perdure.policy import Normalizer, Policy, TaskInfo

HOPPER = TaskInfo("Hopper-v3", 11, (-1.0,) * 3, (1.0,) * 3)


def random_policy(
    *,
    task=HOPPER,
    embedding="geometric",
    hidden=(8, 8),
    activation="tanh",
    seed=0,
    normalize_embedding=False,
    film=False,
    **parts,
):
    """A policy for ``task``; ``parts`` replace arguments of ``Policy``; with ``film`` phi modulates hidden layers."""
    rng = np.random.default_rng(seed)
    phi = {"geometric": Geometric(5), "linear": Linear(), None: None}[embedding]
    law = Fixed(1000) if phi is None else Uniform(200, 1000)
    protocol = HorizonProtocol(phi, law, "terminated", 1.0, 1.0, normalize_embedding=normalize_embedding)
    size = task.observation_size + protocol.embedding_size
    weights = {"log_std": rng.normal(size=task.action_size).astype(np.float32)}
    for name, outputs in (("policy", task.action_size), ("value", 1)):
        sizes = (task.observation_size if film else size, *hidden, outputs)
        for i, (fan_in, fan_out) in enumerate(pairwise(sizes)):
            weight = rng.normal(size=(fan_in, fan_out)) / np.sqrt(fan_in)
            weights[f"{name}.{i}.weight"] = weight.astype(np.float32)
            weights[f"{name}.{i}.bias"] = rng.normal(scale=0.1, size=fan_out).astype(np.float32)
            if film and i < len(hidden):
                for part in ("scale", "shift"):
                    modulation = rng.normal(scale=0.3, size=(protocol.embedding_size, fan_out))
                    weights[f"{name}.{i}.{part}"] = modulation.astype(np.float32)
    normalized = size if normalize_embedding else task.observation_size
    arguments = {
        "task": task,
        "weights": weights,
        "activation": activation,
        "normalizer": Normalizer(rng.normal(size=normalized), rng.uniform(0.5, 2.0, normalized)),
        "protocol": protocol,
        "clock": None if phi is None else Constant(500.0),
        "provenance": {"method": "geometric", "seed": seed, "versions": {"perdure": "0"}},
    }
    return Policy(**(arguments | parts))
