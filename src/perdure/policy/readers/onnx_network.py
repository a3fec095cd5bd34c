"""Read the weights of an ONNX model that is a plain network, so that training can continue it.

Plain is a chain from the observation to the action: a normalizer (an offset, a factor, bounds), linear layers with one
activation function between them, bounds of the action. Exporters write these parts in several ways; each operator below
changes the parts read so far. Whatever is read is compared with what onnxruntime computes from the same model.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perdure.envs import TaskSpec, task_of_environment, task_spec
from perdure.errors import PerdureError
from perdure.horizon import Fixed, HorizonProtocol
from perdure.policy.onnx import model_digest, read_whole, refusing
from perdure.policy.onnx_model import ACTIONS, OnnxModel
from perdure.policy.policy import LARGEST_OBSERVATION, SMALLEST_EPSILON, Normalizer, Policy, TaskInfo
from perdure.policy.readers.sb3_import import library_versions
from perdure.policy.reference import measure_reference, resolve_training_horizon

FloatArray = NDArray[np.float64]
GAMMA = 0.99
"""Stands for the discount, which a model does not say; acting does not depend on it."""
ACTIVATIONS = {
    **{"Relu": "relu", "Tanh": "tanh", "Elu": "elu", "Selu": "selu", "LeakyRelu": "leaky_relu"},
    **{"Sigmoid": "sigmoid", "Softplus": "softplus", "Gelu": "gelu", "Mish": "mish"},
}
"""Operator to our name. What is not the default function (another slope) is found when the actions are compared."""
PASSED = ("Identity", "Cast", "Flatten")
"""Operators that change no number."""
ARITHMETIC = ("Add", "Sub", "Mul", "Div")
BOUNDS = ("Clip", "Max", "Min")
CHECKED = 200
"""Random observations on which the network's actions are compared with the model's."""
TOLERANCE = 1e-4
"""Largest difference of an action, relative to 1 or its size: both compute in 32 bits, in another order."""


def import_onnx(path: str | Path, env: str, *, training_horizon: int | None = None, measure: bool = True) -> Policy:
    """Return the policy of an ONNX model that is a plain network.

    Args:
        path: The file; weights may lie in files beside it.
        env: The environment it was trained in, see `perdure.envs.task_of_environment`.
        training_horizon: Steps of a training episode; the environment's own step limit by default.
        measure: Also measure 20 reference episodes within the training horizon, which takes some seconds.

    Raises:
        PerdureError: If onnx or onnxruntime is not installed, the file is damaged or is no plain network, or model and
            environment do not fit together.
    """
    path = Path(path)
    model = OnnxModel.load(path)
    spec = task_spec(task_of_environment(env))
    model.check_sizes(spec)
    if model.times or model.state:
        raise PerdureError(f"{path} has inputs beside the observation: {NOT_PLAIN}")
    with refusing(str(path)):
        policy = _policy(path, spec, resolve_training_horizon(spec, training_horizon or model.training_horizon))
        _check_actions(policy, model, str(path))
    provenance = {
        "method": f"ONNX ({path.stem})",
        "source": {"file": path.name, "sha256": model_digest(path), "env": env},
        "versions": library_versions(),
    }
    policy = replace(policy, provenance=provenance)
    if measure:
        policy = replace(policy, reference=measure_reference(policy))
    return policy


def _policy(path: Path, spec: TaskSpec, horizon: int) -> Policy:
    """Return the policy of a model's network, trained in episodes of `horizon` steps."""
    network = _read_network(path, spec)
    return Policy(
        task=TaskInfo.of(spec),
        weights=network.weights(),
        activation=network.activation(str(path)),
        normalizer=network.normalizer(spec.observation_size, str(path)),
        protocol=HorizonProtocol(None, Fixed(horizon), "truncated", GAMMA, GAMMA),
    )


NOT_PLAIN = (
    "only a plain network (a normalizer, linear layers, one activation function, bounds) can be read from ONNX; "
    "perdure.extrapolate evaluates any model, and its own learner can continue it in perdure.wrappers.Disturb"
)


@dataclass
class _Network:
    """The parts of a chain of operators read so far."""

    factor: FloatArray = field(default_factory=lambda: np.ones(1))
    offset: FloatArray = field(default_factory=lambda: np.zeros(1))
    """The first layer gets factor * observation + offset."""
    clip: float = LARGEST_OBSERVATION
    """Bound of that number on both sides."""
    layers: list[tuple[FloatArray, FloatArray]] = field(default_factory=list)
    """Weight (in, out) and bias (out,)."""
    activations: list[str] = field(default_factory=list)
    """What follows each layer; the last one has none."""
    low: FloatArray = field(default_factory=lambda: np.full(1, -np.inf))
    high: FloatArray = field(default_factory=lambda: np.full(1, np.inf))
    """Bounds after the last layer so far, or of the observation's numbers."""

    @property
    def bounded(self) -> bool:
        """Whether the last number read has bounds."""
        return bool(np.isfinite(self.low).any() or np.isfinite(self.high).any())

    @property
    def activated(self) -> bool:
        """Whether an activation function follows the last layer."""
        return len(self.activations) == len(self.layers) > 0

    def shift_and_scale(self, factor: FloatArray, offset: FloatArray) -> None:
        """Multiply the last number read by a factor, and add an offset."""
        if self.bounded or self.activated:
            raise PerdureError("it computes with bounded numbers")
        if self.layers:
            weight, bias = self.layers[-1]
            self.layers[-1] = (weight * factor, bias * factor + offset)
        else:
            self.factor = self.factor * factor
            self.offset = self.offset * factor + offset

    def bound(self, low: FloatArray, high: FloatArray) -> None:
        """Cut the last number read to bounds."""
        if self.activated:
            raise PerdureError("it has bounds after an activation function")
        self.low = np.maximum(self.low, low)
        self.high = np.minimum(self.high, high)

    def multiply(self, weight: FloatArray) -> None:
        """Add a linear layer."""
        if weight.ndim != 2:
            raise PerdureError(f"a layer has weights of shape {weight.shape}")
        if not self.layers and self.bounded:
            self.clip = self._symmetric_bound()
        elif self.bounded:
            if np.any(self.low != 0.0) or np.isfinite(self.high).any():
                raise PerdureError("it has bounds between its layers")
            self.activations.append("relu")  # max(x, 0)
        if self.layers and not self.activated:
            raise PerdureError("two linear layers follow each other")
        self.low = np.full(1, -np.inf)
        self.high = np.full(1, np.inf)
        self.layers.append((weight, np.zeros(weight.shape[1])))

    def activate(self, name: str) -> None:
        """Add an activation function."""
        if not self.layers or self.activated or self.bounded:
            raise PerdureError("it has an activation function that follows no linear layer")
        self.activations.append(name)

    def _symmetric_bound(self) -> float:
        bound = float(self.high.max())
        if (self.high != bound).any() or (self.low != -bound).any():
            raise PerdureError("its observations have different bounds")
        return bound

    def weights(self) -> dict[str, NDArray[np.float32]]:
        """Return the weights under the names of policy files."""
        found: dict[str, NDArray[np.float32]] = {}
        for number, (weight, bias) in enumerate(self.layers):
            found[f"policy.{number}.weight"] = weight.astype(np.float32)
            found[f"policy.{number}.bias"] = bias.astype(np.float32)
        return found

    def activation(self, what: str) -> str:
        """Return the activation function of the hidden layers."""
        if self.activated:
            raise PerdureError(
                f"{what} sends its actions through {self.activations[-1]}, which PPO here cannot continue: {NOT_PLAIN}"
            )
        names = sorted(set(self.activations))
        if len(names) > 1:
            raise PerdureError(f"{what} has several activation functions, {', '.join(names)}: {NOT_PLAIN}")
        return next(iter(names), "tanh")

    def normalizer(self, size: int, what: str) -> Normalizer:
        """Return what happens to observations before the first layer."""
        factor = np.broadcast_to(self.factor, size).astype(np.float64)
        offset = np.broadcast_to(self.offset, size).astype(np.float64)
        if not (factor > 0.0).all():
            raise PerdureError(f"{what} multiplies observations by numbers that are not positive: {NOT_PLAIN}")
        if (factor == 1.0).all() and not offset.any() and self.clip == LARGEST_OBSERVATION:
            return Normalizer.identity(size)
        return Normalizer(-offset / factor, 1.0 / np.square(factor), self.clip, SMALLEST_EPSILON)


# From the graph to the chain


def _read_network(path: Path, spec: TaskSpec) -> _Network:
    """Return the network of a model; PerdureError names the operator that is not part of a plain one."""
    import onnx

    network = _Network()
    graph = onnx.load_model_from_string(read_whole(path)).graph
    constants = {each.name: onnx.numpy_helper.to_array(each) for each in graph.initializer}
    for node in graph.node:
        if node.op_type == "Constant" and node.attribute and node.attribute[0].HasField("t"):
            constants[node.output[0]] = onnx.numpy_helper.to_array(node.attribute[0].t)
    for node, value in _chain(graph, constants, str(path)):
        try:
            _read_operator(network, node, value, constants)
        except PerdureError as error:
            raise PerdureError(f"{path}: {error}; {NOT_PLAIN}") from None
    if not network.layers:
        raise PerdureError(f"{path} has no linear layer: {NOT_PLAIN}")
    inputs = network.layers[0][0].shape[0]
    outputs = network.layers[-1][0].shape[1]
    if (inputs, outputs) != (spec.observation_size, spec.action_size):
        raise PerdureError(
            f"{path} has a network of {inputs} inputs and {outputs} outputs, but {spec.name} gives "
            f"{spec.observation_size} numbers and takes {spec.action_size}"
        )
    if not network.activated and ((network.low > spec.action_low).any() or (network.high < spec.action_high).any()):
        raise PerdureError(f"{path} cuts its actions to less than the range of {spec.name}: {NOT_PLAIN}")
    return network


def _chain(graph: Any, constants: Mapping[str, NDArray[Any]], what: str) -> list[tuple[Any, str]]:
    """Return the operators between observation and action, each with the name of the value that it changes."""
    makers = {output: node for node in graph.node for output in node.output}
    outputs = [each.name for each in graph.output]
    value = next((name for name in ACTIONS if name in outputs), outputs[0])
    inputs = {each.name for each in graph.input} - set(constants)
    found: list[tuple[Any, str]] = []
    while value not in inputs:
        if value not in makers or len(found) > len(graph.node):
            raise PerdureError(f"{what}: its action does not come from its observation: {NOT_PLAIN}")
        node = makers[value]
        changed = [name for name in node.input if name and name not in constants]
        if len(changed) != 1:
            raise PerdureError(f"{what}: its operator {node.op_type} joins {len(changed)} values: {NOT_PLAIN}")
        value = changed[0]
        found.append((node, value))
    return found[::-1]


def _read_operator(network: _Network, node: Any, value: str, constants: Mapping[str, NDArray[Any]]) -> None:
    """Add one operator to the network; PerdureError if it is not part of a plain one."""
    kind = node.op_type
    given = [np.asarray(constants[name], np.float64) for name in node.input if name in constants]
    first = node.input[0] == value
    if kind in PASSED:
        return
    if kind in ACTIVATIONS:
        network.activate(ACTIVATIONS[kind])
    elif kind in ARITHMETIC and len(given) == 1:
        _compute(network, kind, _vector(given[0]), first)
    elif kind in BOUNDS:
        low, high = _bounds(kind, node, constants)
        network.bound(low, high)
    elif kind == "MatMul" and first:
        network.multiply(given[0])
    elif kind == "Gemm" and first:
        _gemm(network, node, given)
    else:
        raise PerdureError(f"its operator {kind} is not part of a plain network")


def _vector(constant: FloatArray) -> FloatArray:
    """Return a constant of one row as a vector."""
    if constant.size != max(constant.shape, default=1):
        raise PerdureError(f"it computes with a constant of shape {constant.shape}")
    return constant.reshape(-1)


def _compute(network: _Network, kind: str, constant: FloatArray, first: bool) -> None:
    """Add, subtract, multiply or divide by a constant; `first`: the value comes before the operator."""
    zero = np.zeros(1)
    one = np.ones(1)
    if kind == "Add":
        network.shift_and_scale(one, constant)
    elif kind == "Mul":
        network.shift_and_scale(constant, zero)
    elif kind == "Sub" and first:
        network.shift_and_scale(one, -constant)
    elif kind == "Div" and first and constant.all():
        network.shift_and_scale(1.0 / constant, zero)
    else:
        raise PerdureError(f"its operator {kind} has the value in second place, or a divisor of 0")


def _bounds(kind: str, node: Any, constants: Mapping[str, NDArray[Any]]) -> tuple[FloatArray, FloatArray]:
    """Return the bounds that an operator cuts to."""
    low = np.full(1, -np.inf)
    high = np.full(1, np.inf)
    if kind == "Clip":
        names = node.input  # the value and its bounds, which may be missing or ""
        if len(names) > 1 and names[1]:
            low = _vector(np.asarray(constants[names[1]], np.float64))
        if len(names) > 2 and names[2]:
            high = _vector(np.asarray(constants[names[2]], np.float64))
        return low, high
    (constant,) = (_vector(np.asarray(constants[name], np.float64)) for name in node.input if name in constants)
    if kind == "Min":
        return low, constant
    return constant, high


def _gemm(network: _Network, node: Any, given: list[FloatArray]) -> None:
    """Add a layer of the operator Gemm: alpha * x @ weight + beta * bias."""
    from onnx import helper

    settings: dict[str, Any] = {"alpha": 1.0, "beta": 1.0, "transA": 0, "transB": 0}
    for each in node.attribute:
        settings[each.name] = helper.get_attribute_value(each)
    if settings["transA"]:
        raise PerdureError("its operator Gemm turns the observation")
    weight = given[0]
    if settings["transB"]:
        weight = weight.T
    network.multiply(settings["alpha"] * weight)
    if len(given) > 1:
        network.shift_and_scale(np.ones(1), settings["beta"] * _vector(given[1]))


def _check_actions(policy: Policy, model: OnnxModel, what: str) -> None:
    """Raise PerdureError unless the policy acts as onnxruntime says that the model does."""
    rng = np.random.default_rng(0)
    size = policy.task.observation_size
    spread = np.sqrt(policy.normalizer.var + policy.normalizer.epsilon)
    observations = policy.normalizer.mean + 2.0 * spread * rng.standard_normal((CHECKED, size))
    ours = policy.act(observations, np.zeros(CHECKED))
    theirs = np.clip(np.asarray(model(observations), np.float64), policy.task.action_low, policy.task.action_high)
    apart = float((np.abs(ours - theirs.reshape(ours.shape)) / np.maximum(1.0, np.abs(ours))).max())
    if not apart < TOLERANCE:
        raise PerdureError(f"{what}: the network read from it acts otherwise (by {apart:.2g}): {NOT_PLAIN}")
