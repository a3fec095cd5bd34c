"""Export a policy as a complete ONNX model: normalizer, time-to-go, network, action box."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perdure.horizon import Clock, Constant
from perdure.policy.errors import PolicyError
from perdure.policy.onnx.graph import IR_VERSION, OPSET, Graph, Value
from perdure.policy.onnx.model import TRAINING_HORIZON, OnnxModel, require
from perdure.policy.policy import Policy
from perdure.runs import write_atomic

CHECKED = 1_000
"""Random observations on which the model's actions are compared with the policy's."""
TOLERANCE = 5e-6
"""Largest difference of an action component, relative to 1 or its size. Both sides compute in 32 bits and add up in
another order: measured, 0.7e-6 for Hopper's 64 x 64 network and 2e-6 for 376 inputs and 256 x 256."""

_ACTIVATIONS: dict[str, Callable[[Graph, Value], Value]] = {
    "relu": lambda graph, x: graph.node("Relu", x),
    "tanh": lambda graph, x: graph.node("Tanh", x),
    "elu": lambda graph, x: graph.node("Elu", x),
    "selu": lambda graph, x: graph.node("Selu", x, alpha=1.6732632423543772, gamma=1.0507009873554805),
    "leaky_relu": lambda graph, x: graph.node("LeakyRelu", x, alpha=0.01),
    "sigmoid": lambda graph, x: graph.node("Sigmoid", x),
    "silu": lambda graph, x: graph.node("Mul", x, graph.node("Sigmoid", x)),
    "gelu": lambda graph, x: _gelu(graph, x),
    "softplus": lambda graph, x: graph.node("Softplus", x),
    "mish": lambda graph, x: graph.node("Mul", x, graph.node("Tanh", graph.node("Softplus", x))),
}


def export_onnx(policy: Policy, path: str | Path, clock: Clock | None = None) -> Path:
    """Write a policy as an ONNX model, whole or not at all, and return the path.

    | input | shape | of |
    |---|---|---|
    | observation | (n, observation_size) | every model |
    | elapsed | (n,) | steps since reset; models with a time-to-go input, unless the clock is constant |
    | horizon | (n,) | T; models whose clock is left open: the time-to-go is horizon - elapsed |

    The output is `action`, shape (n, action_size), inside the action box. All are 64-bit numbers.

    Args:
        policy: What is exported.
        path: The file.
        clock: Fixed in the model; None leaves the time-to-go to the caller.

    Raises:
        PolicyError: If onnx or onnxruntime is not installed, the policy takes no clock, or onnxruntime's actions differ
            from the policy's.
    """
    require()
    if clock is not None and not policy.has_clock:
        raise PolicyError(f"this {policy.task.name} policy has no time-to-go input, so it takes no clock")
    data = _model(policy, clock).SerializeToString()
    _compare(policy, clock, OnnxModel(data, str(path)))
    write_atomic(Path(path), data)
    return Path(path)


def _model(policy: Policy, clock: Clock | None) -> Any:
    from onnx import TensorProto, checker, helper

    graph = Graph()
    times = _time_inputs(policy, clock)
    action = _act(graph, policy, _phi(graph, policy, clock))
    shapes: dict[str, list[str | int | None]] = {name: ["n"] for name in times}
    shapes["observation"] = ["n", policy.task.observation_size]
    inputs = [helper.make_tensor_value_info(name, TensorProto.DOUBLE, shape) for name, shape in shapes.items()]
    output = helper.make_tensor_value_info("action", TensorProto.DOUBLE, ["n", policy.task.action_size])
    nodes = [*graph.nodes, helper.make_node("Identity", [action.name], ["action"])]
    model = helper.make_model(
        helper.make_graph(nodes, "policy", inputs, [output], graph.constants),
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="perdure",
    )
    helper.set_model_props(model, _notes(policy, clock))
    checker.check_model(model, full_check=True)
    return model


def _notes(policy: Policy, clock: Clock | None) -> dict[str, str]:
    label = "none" if not policy.has_clock else "input" if clock is None else clock.label
    known = {key: value for key, value in policy.provenance.items() if isinstance(value, str | int | float)}
    return {
        "perdure.task": policy.task.name,
        "perdure.clock": label,
        TRAINING_HORIZON: str(policy.training_horizon),
        "perdure.provenance": json.dumps(known, sort_keys=True),
    }


def _time_inputs(policy: Policy, clock: Clock | None) -> tuple[str, ...]:
    if not policy.has_clock or isinstance(clock, Constant):
        return ()
    return ("elapsed", "horizon") if clock is None else ("elapsed",)


def _phi(graph: Graph, policy: Policy, clock: Clock | None) -> Value | None:
    """Return phi of each row, shape (n, embedding_size), or (1, embedding_size) where it stands still."""
    if not policy.has_clock:
        return None
    if isinstance(clock, Constant):
        return graph.constant(policy.embed(*clock.time(np.zeros(1))))
    elapsed = Value(graph, "elapsed", 1)
    times = (elapsed, Value(graph, "horizon", 1)) if clock is None else clock.time(elapsed)
    phi: Value = policy.protocol.embed(*times)
    return phi


def _act(graph: Graph, policy: Policy, phi: Value | None) -> Value:
    hidden = _inputs(graph, policy, Value(graph, "observation", 2), phi)
    layers = sum(name.startswith("policy.") and name.endswith(".weight") for name in policy.weights)
    film = "policy.0.scale" in policy.weights
    if film:
        hidden, phi = _split(graph, hidden, policy.task.observation_size)
    for layer in range(layers):
        hidden = graph.node(
            "Add", graph.node("MatMul", hidden, _matrix(policy, layer, "weight")), _matrix(policy, layer, "bias")
        )
        if layer < layers - 1:
            if film:
                scale, shift = (graph.node("MatMul", phi, _matrix(policy, layer, part)) for part in ("scale", "shift"))
                factor = graph.node("Add", scale, np.float32(1))
                hidden = graph.node("Add", graph.node("Mul", factor, hidden), shift)
            hidden = _ACTIVATIONS[policy.activation](graph, hidden)
    low, high = np.array(policy.task.action_low), np.array(policy.task.action_high)
    if policy.squash is not None:
        hidden = _squashed(graph, hidden, policy.squash.limit, low, high)
    return graph.node("Min", graph.node("Max", graph.cast(hidden, np.float64), low), high)


def _matrix(policy: Policy, layer: int, part: str) -> NDArray[np.float32]:
    return np.asarray(policy.weights[f"policy.{layer}.{part}"], np.float32)


def _split(graph: Graph, inputs: Value, first: int) -> tuple[Value, Value]:
    """Return the first columns and the others."""
    axis, end = np.array([1]), np.array([np.iinfo(np.int64).max])
    head = graph.node("Slice", inputs, np.array([0]), np.array([first]), axis)
    return head, graph.node("Slice", inputs, np.array([first]), end, axis)


def _inputs(graph: Graph, policy: Policy, observation: Value, phi: Value | None) -> Value:
    """Return the network's input: normalized observation and phi, 32 bits."""
    if phi is not None:
        phi = _for_each_row(graph, observation, phi, policy.protocol.embedding_size)
    normalizer = policy.normalizer
    if phi is not None and policy.protocol.normalize_embedding:
        observation, phi = graph.node("Concat", observation, phi, axis=1), None
    scaled = (observation - normalizer.mean) / np.sqrt(normalizer.var + normalizer.epsilon)
    seen = graph.cast(scaled.clip(-normalizer.clip, normalizer.clip), np.float32)
    return seen if phi is None else graph.node("Concat", seen, graph.cast(phi, np.float32), axis=1)


def _for_each_row(graph: Graph, observation: Value, phi: Value, size: int) -> Value:
    """Repeat a constant phi, which is one row, for every observation."""
    if not _is_constant(graph, phi):
        return phi
    rows = graph.node("Slice", graph.node("Shape", observation, ndim=1), np.array([0]), np.array([1]), np.array([0]))
    return graph.node("Expand", phi, graph.node("Concat", rows, np.array([size]), axis=0), ndim=2)


def _is_constant(graph: Graph, value: Value) -> bool:
    return any(constant.name == value.name for constant in graph.constants)


def _squashed(graph: Graph, outputs: Value, limit: float, low: NDArray[np.float64], high: NDArray[np.float64]) -> Value:
    """See `TanhSquash`: the same operations in 32 bits, in the same order."""
    bound, one, half = np.float32(limit), np.float32(1), np.float32(0.5)
    low32, high32 = low.astype(np.float32), high.astype(np.float32)
    scaled = graph.node("Tanh", graph.node("Min", graph.node("Max", outputs, -bound), bound))
    share = graph.node("Mul", graph.node("Add", scaled, one), half)
    return graph.node("Add", graph.node("Mul", share, high32 - low32), low32)


def _gelu(graph: Graph, x: Value) -> Value:
    erf = graph.node("Erf", graph.node("Mul", x, np.float32(np.sqrt(0.5))))
    return graph.node("Mul", graph.node("Mul", x, np.float32(0.5)), graph.node("Add", erf, np.float32(1)))


def _compare(policy: Policy, clock: Clock | None, model: OnnxModel) -> None:
    """Refuse a model whose actions are not the policy's."""
    rng = np.random.default_rng(0)
    size = policy.task.observation_size
    observations = policy.normalizer.mean[:size] + 2.0 * policy.observation_std * rng.standard_normal((CHECKED, size))
    elapsed = np.floor(rng.uniform(0, 2_000, CHECKED))
    times: tuple[Any, Any] = (elapsed, elapsed + np.floor(rng.uniform(0, 1_000, CHECKED)))
    if clock is not None:
        times = clock.time(elapsed)
    expected = policy.act_at(observations, *times)
    given = {"elapsed": elapsed, "horizon": times[1]}
    found = model(observations, **{name: given[name] for name in model.times})
    worst = float((np.abs(found - expected) / np.maximum(np.abs(expected), 1.0)).max())
    if not worst <= TOLERANCE:
        raise PolicyError(
            f"the ONNX model's actions differ from the policy's by up to {worst:.2g}; nothing was written"
        )
