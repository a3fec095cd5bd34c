"""`export_onnx`: write a policy as an ONNX model, and check that it acts as the policy does.

The code of policies, embeddings and clocks is run once on a `Value` in place of an array, and each function of NumPy
leaves its operator in a `Graph`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from perdure.errors import PerdureError
from perdure.horizon import Clock, Constant
from perdure.policy.onnx import require
from perdure.policy.onnx_model import TRAINING_HORIZON, OnnxModel
from perdure.policy.policy import Policy
from perdure.runs import write_atomic

OPSET = 17
IR_VERSION = 8
"""Of onnx 1.12 (2022): what runtimes on robots read as well."""
CHECKED = 1_000
"""Random observations on which the model's actions are compared with the policy's."""
TOLERANCE = 5e-5
"""Largest difference of an action component, relative to 1 or its size. Both sides compute in 32 bits and add up in
another order: measured, 0.7e-6 for Hopper's 64 x 64 network and 5e-6 for 376 inputs around 100 and 256 x 256."""


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
        PerdureError: If onnx or onnxruntime is not installed, the policy takes no clock, or onnxruntime's actions
            differ from the policy's.
    """
    require()
    if policy.task.discrete_actions:
        raise PerdureError(f"this {policy.task.name} policy has discrete actions, which are not exported")
    if clock is not None and not policy.has_clock:
        raise PerdureError(f"this {policy.task.name} policy has no time-to-go input, so it takes no clock")
    data = _model(policy, clock).SerializeToString()
    _compare(policy, clock, OnnxModel(data, str(path)))
    return write_atomic(path, data)


def _model(policy: Policy, clock: Clock | None) -> Any:
    from onnx import TensorProto, checker, helper

    graph = Graph()
    shapes: dict[str, list[str | int]] = {}
    if policy.has_clock and not isinstance(clock, Constant):
        shapes["elapsed"] = ["n"]
        if clock is None:
            shapes["horizon"] = ["n"]
    shapes["observation"] = ["n", policy.task.observation_size]
    inputs = [helper.make_tensor_value_info(name, TensorProto.DOUBLE, shape) for name, shape in shapes.items()]
    output = helper.make_tensor_value_info("action", TensorProto.DOUBLE, ["n", policy.task.action_size])
    observation = Value(graph, "observation", 2)
    action = policy.act_from(_inputs(policy, observation, _phi(policy, clock, observation)))
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
    label = "none"
    if clock is not None:
        label = clock.label
    elif policy.has_clock:
        label = "input"
    known = {key: value for key, value in policy.provenance.items() if isinstance(value, str | int | float)}
    return {
        "perdure.task": policy.task.name,
        "perdure.clock": label,
        TRAINING_HORIZON: str(policy.training_horizon),
        "perdure.provenance": json.dumps(known, sort_keys=True),
    }


def _phi(policy: Policy, clock: Clock | None, observation: Value) -> Value | None:
    """Return phi of each row, shape (n, embedding_size)."""
    if not policy.has_clock:
        return None
    graph = observation.graph
    if isinstance(clock, Constant):
        phi = policy.embed(*clock.time(np.zeros(1)))
        rows = graph.node("Shape", observation, ndim=1, end=1)
        shape = graph.node("Concat", rows, np.array(phi.shape[1:]), axis=0)
        return graph.node("Expand", graph.constant(phi), shape, ndim=2)
    elapsed = Value(graph, "elapsed", 1)
    times = (elapsed, Value(graph, "horizon", 1))
    if clock is not None:
        times = clock.time(elapsed)
    phi_of_rows: Value = policy.protocol.embed(*times)
    return phi_of_rows


def _inputs(policy: Policy, observation: Value, phi: Value | None) -> Value:
    """Return what `Policy.inputs` returns."""
    normalizer: Any = policy.normalizer
    if phi is not None and policy.protocol.normalize_embedding:
        normalized: Value = normalizer(observation.beside(phi)).astype(np.float32)
        return normalized
    seen: Value = normalizer(observation).astype(np.float32)
    if phi is None:
        return seen
    return seen.beside(phi.astype(np.float32))


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
        raise PerdureError(
            f"the ONNX model's actions differ from the policy's by up to {worst:.2g}; nothing was written"
        )


@dataclass(eq=False)
class Graph:
    """Nodes and constants in the order in which they were made."""

    nodes: list[Any] = field(default_factory=list)
    constants: list[Any] = field(default_factory=list)

    def constant(self, array: Any) -> Value:
        """Add a constant."""
        from onnx import numpy_helper

        name = f"constant_{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(array), name))
        return Value(self, name, np.ndim(array), np.asarray(array).dtype)

    def node(
        self, kind: str, *inputs: Any, ndim: int | None = None, dtype: Any = np.float64, **attributes: Any
    ) -> Value:
        """Add an operator.

        Args:
            kind: Name of the operator.
            inputs: Values; arrays become constants.
            ndim: Dimensions of the result; by default the most that an input has.
            dtype: Of the result.
            attributes: Of the operator.
        """
        from onnx import helper

        values = [each if isinstance(each, Value) else self.constant(each) for each in inputs]
        if ndim is None:
            ndim = max(value.ndim for value in values)
        name = f"{kind.lower()}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, [value.name for value in values], [name], **attributes))
        return Value(self, name, ndim, dtype)


OPERATORS = {
    "add": "Add",
    "subtract": "Sub",
    "multiply": "Mul",
    "divide": "Div",
    "power": "Pow",
    "matmul": "MatMul",
    "maximum": "Max",
    "minimum": "Min",
    "negative": "Neg",
    "greater": "Greater",
    "less": "Less",
    "exp": "Exp",
    "tanh": "Tanh",
    "expit": "Sigmoid",
    "erf": "Erf",
}
"""NumPy's and SciPy's functions of arrays, and the operators of ONNX that compute the same."""


@dataclass(frozen=True, eq=False)
class Value(np.lib.mixins.NDArrayOperatorsMixin):
    """A tensor in a graph, with as much of NumPy's interface as policies, embeddings and clocks use.

    What computes actions from arrays leaves its nodes in the graph where it is given a value: a third-party embedding,
    too, is exported without ONNX code.
    """

    graph: Graph
    name: str
    ndim: int
    dtype: Any = np.float64

    def __array_ufunc__(self, function: np.ufunc, method: str, *inputs: Any, out: Any = None) -> Any:
        """Add the operator of a function of NumPy. The result is always a new value, also in place of `out`."""
        values = [each if isinstance(each, Value) else np.asarray(each, self.dtype) for each in inputs]
        kind = function.__name__
        if kind == "expm1":
            return np.exp(values[0]) - 1.0
        if kind == "logaddexp":
            return self._node("Softplus", values[0] - values[1]) + values[1]
        if kind == "remainder":  # C's fmod, which is Python's % where nothing is negative
            return self._node("Mod", *values, fmod=1)
        if kind not in OPERATORS or method != "__call__":
            return NotImplemented
        found = self._node(OPERATORS[kind], *values)
        if kind in ("greater", "less"):
            return found.astype(self.dtype)
        return found

    def _node(self, kind: str, *inputs: Any, **attributes: Any) -> Value:
        return self.graph.node(kind, *inputs, dtype=self.dtype, **attributes)

    def __getitem__(self, index: Any) -> Value:
        if index == (..., None):
            return self._node("Unsqueeze", self, np.array([-1]), ndim=self.ndim + 1)
        if not (isinstance(index, tuple) and len(index) == 2 and index[0] == slice(None)):
            raise TypeError(f"only [..., None] and [:, first:end] can be written in ONNX here, not [{index!r}]")
        first, end, _ = index[1].indices(np.iinfo(np.int64).max)
        return self._node("Slice", self, np.array([first]), np.array([end]), np.array([1]))

    def astype(self, dtype: Any) -> Value:
        """Convert to another type of number."""
        from onnx import helper

        return self.graph.node("Cast", self, dtype=dtype, to=helper.np_dtype_to_tensor_dtype(np.dtype(dtype)))

    def beside(self, other: Value) -> Value:
        """Return the columns of both, shape (n, ...)."""
        return self._node("Concat", self, other, axis=1)

    def clip(self, min: float | None = None, max: float | None = None) -> Value:
        """Clip to a range, like NumPy's method."""
        result = self
        if min is not None:
            result = result._node("Max", result, np.asarray(min, self.dtype))
        if max is not None:
            result = result._node("Min", result, np.asarray(max, self.dtype))
        return result
