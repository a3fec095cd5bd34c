"""Policies as ONNX models: export with `export_onnx`, run a model of any maker with `OnnxModel`."""

from __future__ import annotations

import io
import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from perdure.errors import MANUAL, PerdureError
from perdure.horizon import Clock, Constant
from perdure.policy.policy import Policy
from perdure.policy.reference import LONGEST_HORIZON
from perdure.runs import config_digest, file_digest, read_bounded, write_atomic

if TYPE_CHECKING:
    from perdure.envs import TaskSpec

__all__ = ["OnnxModel", "export_onnx", "is_onnx", "metadata"]

Arrays = dict[str, NDArray[Any]]
"""Arrays by the names of a model's inputs."""
OPSET = 17
IR_VERSION = 8
"""Of onnx 1.12 (2022): what runtimes on robots read as well."""
DOMAINS = ("", "ai.onnx", "ai.onnx.ml", "com.microsoft")
"""Operators that onnxruntime includes. Any other would need third-party code."""
TIMES = ("elapsed", "horizon")
"""Names of inputs that hold the time."""
ACTIONS = ("action", "actions", "continuous_actions")
"""Names of the action output if there are several outputs; else the first output is used."""
TRAINING_HORIZON = "perdure.training_horizon"
"""Metadata that `export_onnx` writes: steps."""
MAX_BYTES = 500_000_000
"""Of a model with the weights beside it."""
CHECKED = 1_000
"""Random observations on which the model's actions are compared with the policy's."""
TOLERANCE = 5e-5
"""Largest difference of an action component, relative to 1 or its size. Both sides compute in 32 bits and add up in
another order: measured, 0.7e-6 for Hopper's 64 x 64 network and 5e-6 for 376 inputs around 100 and 256 x 256."""


# Models as policies


def is_onnx(path: str | Path) -> bool:
    """Return whether a file is named as an ONNX model is, in any case."""
    return str(path).lower().endswith(".onnx")


def require() -> None:
    """Raise PerdureError unless onnx and onnxruntime are installed."""
    missing = [name for name in ("onnx", "onnxruntime") if find_spec(name) is None]
    if missing:
        raise PerdureError(f"ONNX needs {' and '.join(missing)}: pip install 'perdure[onnx]'")


class OnnxModel:
    """A model: observations in, actions out. Reading one runs none of its maker's code.

    An input ``X_in`` with an output ``X_out`` of the same shape is a state, zero at first. Outputs besides actions and
    states are ignored.

    Args:
        data: The file, with its weights inside.
        what: Which file it is, for messages.

    Raises:
        PerdureError: If it is no ONNX model, needs operators that are not in it or files that are not beside it, or has
            other inputs than one observation, state and, perhaps, `elapsed` and `horizon`, or its metadata name no
            horizon of at least 1 step.
    """

    def __init__(self, data: bytes, what: str) -> None:
        require()
        with _refusing(what):
            self._open(data, what)
        self._thread: ThreadPoolExecutor | None = None
        if b"Loop" in data:  # the only operator that may not end
            self._thread = ThreadPoolExecutor(1)

    def _open(self, data: bytes, what: str) -> None:
        import onnxruntime

        _check(data, what)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4
        with redirect_stdout(io.StringIO()):  # it prints before it raises
            self._session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
        inputs = {each.name: each for each in self._session.get_inputs()}
        outputs = {each.name: each for each in self._session.get_outputs()}
        if "time_step" in inputs:  # as mjlab, BeyondMimic and holosoma name it
            raise PerdureError(
                f"{what} tracks a motion: its input time_step selects the reference among its outputs "
                f"({', '.join(outputs)}), which the next observation must contain. Evaluate a Python function that "
                f"does this and decides what follows the motion's end: {MANUAL}#motion-tracking"
            )
        self.times: tuple[str, ...] = tuple(name for name in TIMES if name in inputs)
        """Which inputs hold the time."""
        boolean = [name for name in self.times if inputs[name].type == "tensor(bool)"]
        if boolean:
            raise PerdureError(f"{what}: the input {boolean[0]} must be a number of steps, not tensor(bool)")
        # An input X_in whose shape an output X_out has is a state; what else there is must be the observation.
        self.state: dict[str, str] = {}
        """Inputs that hold the state of a recurrent policy, each with the output that follows it."""
        self._zero: Arrays = {}
        for name, value in inputs.items():
            after = f"{name.removesuffix('_in')}_out"
            if name.endswith("_in") and after in outputs:
                zero = _zeros(value)
                if zero.shape == _zeros(outputs[after]).shape:
                    self.state[name] = after
                    self._zero[name] = zero
        others = [each for name, each in inputs.items() if name not in (*TIMES, *self.state)]
        if len(others) != 1:
            raise PerdureError(
                f"{what} has the inputs {', '.join(inputs)}; expected are one observation, for a state X_in with an "
                "output X_out of the same shape and, for a time-to-go, elapsed and horizon"
            )
        self._input = others[0]
        self._what = what
        if self._input.shape and self._input.shape[0] == 0:
            raise PerdureError(f"{what} takes batches of 0 observations")
        self._dtype = _dtype(self._input.type)
        self._types = {name: _dtype(inputs[name].type) for name in self.times}
        names = [name for name in outputs if name not in self.state.values()]
        action = next((name for name in ACTIONS if name in names), names[0])
        self._outputs = [action, *self.state.values()]
        self._action_shape = outputs[action].shape
        self.__name__ = Path(what).stem
        self.training_horizon = _training_horizon(self._session.get_modelmeta().custom_metadata_map, what)
        """Steps of a training episode, if the model was exported with `export_onnx`; else None."""

    def check_sizes(self, spec: TaskSpec) -> None:
        """Raise PerdureError if the model says that it takes or returns other numbers of values than a task has."""
        actions = None  # of discrete actions it may return a number for each choice
        if not spec.discrete_actions:
            actions = spec.action_size
        for does, shape, size, other in (
            ("takes", self._input.shape, spec.observation_size, "gives"),
            ("returns", self._action_shape, actions, "takes"),
        ):
            known = [each for each in shape[1:] if isinstance(each, int)]  # no shape at all: the model does not say
            if size is not None and 1 <= len(known) == len(shape) - 1 and math.prod(known) != size:
                raise PerdureError(f"{self._what} {does} {math.prod(known)} numbers, but {spec.name} {other} {size}")

    @property
    def signature(self) -> dict[str, str]:
        """Return its inputs and outputs with their shapes, and which of them are state and action."""
        values = {"inputs": self._session.get_inputs(), "outputs": self._session.get_outputs()}
        rows = {side: ", ".join(f"{each.name} {each.shape}" for each in found) for side, found in values.items()}
        return rows | {"state": ", ".join(self.state) or "none", "action": self._outputs[0]}

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Return the model in a file, with the weights in files beside it.

        Raises:
            PerdureError: If there is no such file, or see the class.
        """
        require()
        with _refusing(str(path)):
            data = _whole(Path(path))
        return cls(data, str(path))

    def __call__(
        self,
        observations: Any,
        state: Sequence[Arrays] | None = None,
        episode_starts: NDArray[np.bool_] | None = None,
        **times: NDArray[np.float64],
    ) -> Any:
        """Return actions for a batch; of a recurrent model (actions, state). See `FunctionPolicy`.

        A row's action does not depend on the other rows, bit for bit: each is run alone.

        Args:
            observations: Shape (n, *shape).
            state: As returned last; None: zeros.
            episode_starts: Rows that begin with zeros, shape (n,).
            times: `elapsed` and `horizon`, shape (n,), as far as the model has these inputs.

        Raises:
            PerdureError: If the model does not take such observations or times.
        """
        rows = self._shaped(np.asarray(observations))
        if set(times) != set(self.times):
            has = " and ".join(self.times) or "no time"
            raise PerdureError(f"{self._what} takes {has}, but was given {' and '.join(times) or 'no time'}")
        feed = {self._input.name: rows}
        feed |= {name: np.asarray(value, self._types[name]) for name, value in times.items()}
        size = self._input.shape[0]
        if not isinstance(size, int):  # the model leaves it open
            size = 1
        before = [self._zero] * len(rows)
        if state is not None:
            before = list(state)
        if episode_starts is not None:
            for row in np.flatnonzero(episode_starts):
                before[row] = self._zero
        results = self._run([row | each for row, each in zip(_single_rows(feed, size), before, strict=True)])
        actions = np.concatenate([result[0][:1] for result in results])
        if not self.state:
            return actions
        after = [dict(zip(self.state, result[1:], strict=True)) for result in results]
        for each in after:
            if any(each[name].shape != zero.shape for name, zero in self._zero.items()):
                raise PerdureError(f"{self._what}: its state must keep its shape, but it grows or shrinks")
        return actions, after

    def _shaped(self, rows: NDArray[Any]) -> NDArray[Any]:
        """Return observations in the model's own shape and dtype."""
        wanted = [size if isinstance(size, int) else -1 for size in self._input.shape[1:]]
        given = rows.shape[1:]
        fits = len(given) == len(wanted) and all(a in (b, -1) for a, b in zip(wanted, given, strict=True))
        self._check_numbers(rows)
        try:
            if not fits:
                rows = rows.reshape(len(rows), *wanted)
            return rows.astype(self._dtype)
        except ValueError:
            raise PerdureError(
                f"{self._what} takes observations of shape (n, {', '.join(map(str, self._input.shape[1:]))}), "
                f"got {rows.shape}"
            ) from None

    def _check_numbers(self, rows: NDArray[Any]) -> None:
        """Refuse numbers that the model's input cannot hold, such as 0.5 for whole numbers."""
        if np.issubdtype(self._dtype, np.floating) or np.issubdtype(rows.dtype, np.bool_):
            return
        with np.errstate(invalid="ignore"):
            held = np.array_equal(rows.astype(self._dtype), rows)
        if not held:
            raise PerdureError(f"{self._what} takes observations of type {self._input.type}, which cannot hold these")

    def _run(self, feeds: list[Arrays]) -> list[list[NDArray[Any]]]:
        """Run the model on each feed; with loops in another thread, so that an interruption ends an endless one."""
        import onnxruntime

        options = onnxruntime.RunOptions()
        options.log_severity_level = 4

        def rows() -> list[list[NDArray[Any]]]:
            return [self._session.run(self._outputs, feed, options) for feed in feeds]

        with _refusing(self._what):
            if self._thread is None:
                return rows()
            try:
                job = self._thread.submit(rows)
                while not job.done():
                    wait([job], 0.5)  # without a limit, an interruption that another thread gets would wait too
                return job.result()
            finally:
                options.terminate = True


@contextmanager
def _refusing(what: str) -> Iterator[None]:
    """Raise whatever a damaged model makes onnx and onnxruntime raise as PerdureError: their errors share no base."""
    try:
        yield
    except PerdureError:
        raise
    except Exception as error:
        text = " ".join(str(error).split())[:300]
        raise PerdureError(f"{what} cannot be run by onnxruntime: {text or type(error).__name__}") from None


def _zeros(value: Any) -> NDArray[Any]:
    """Return the state of one episode at its start; an open dimension, wherever it is, counts episodes."""
    return np.zeros([size if isinstance(size, int) else 1 for size in value.shape], _dtype(value.type))


def _single_rows(feed: Arrays, size: int) -> Iterator[Arrays]:
    """Yield each row of the feed, repeated to fill a batch of the size that the model asks for."""
    for row in range(len(next(iter(feed.values())))):
        yield {name: values[[row] * size] for name, values in feed.items()}


def _training_horizon(metadata: Mapping[str, str], what: str) -> int | None:
    text = metadata.get(TRAINING_HORIZON, "inf")
    try:
        steps = float(text)
    except ValueError:
        steps = math.nan
    if not 1.0 <= steps <= LONGEST_HORIZON and steps != math.inf:
        wanted = f"a number of steps from 1 to {LONGEST_HORIZON:,}"
        raise PerdureError(f"{what}: its metadata {TRAINING_HORIZON} is {text!r}; it is {wanted}")
    if math.isinf(steps):
        return None
    return int(steps)


def _dtype(kind: str) -> Any:
    """Return NumPy's type of "tensor(float)"."""
    names = {
        **{"float": np.float32, "double": np.float64, "float16": np.float16},
        **{"uint8": np.uint8, "int32": np.int32, "int64": np.int64, "bool": np.bool_},
    }
    name = kind.removeprefix("tensor(").rstrip(")")
    if name not in names:
        raise PerdureError(f"an input of type {kind} cannot hold observations; {', '.join(names)} can")
    return names[name]


def metadata(path: str | Path) -> dict[str, str]:
    """Return what the exporter of a model wrote beside its graph (`metadata_props`), by name. Runs nothing.

    Raises:
        PerdureError: If there is no such file, it is no ONNX model, or onnx is not installed.
    """
    require()
    return {each.key: each.value for each in _parse(_read(path), str(path)).metadata_props}


def model_digest(path: Path) -> str:
    """Return the SHA-256 of a file; of an ONNX model with weights in files beside it that of all their digests.

    Raises:
        PerdureError: If it is named as an ONNX model and is none, or such a file is missing.
    """
    if not is_onnx(path):
        return file_digest(path)
    require()
    with _refusing(str(path)):
        beside = sorted({_beside(tensor, path) for tensor in _outside(_parse(_read(path), str(path)))})
    if not beside:
        return file_digest(path)
    return config_digest({"files": [file_digest(each) for each in (path, *beside)]})


def _whole(path: Path) -> bytes:
    """Return a model with the weights that lie in files beside it."""
    data = _read(path)
    model = _parse(data, str(path))
    files: dict[Path, bytes] = {}
    total = len(data)
    for tensor in _outside(model):
        file = _beside(tensor, path)
        if file not in files:
            files[file] = read_bounded(file, MAX_BYTES)
        content = files[file]
        place = {each.key: each.value for each in tensor.external_data}
        start = int(place.get("offset", 0))
        length = int(place.get("length", len(content) - start))
        total += length
        if not 0 <= start <= start + length <= len(content) or total > MAX_BYTES:
            raise PerdureError(f"{path} and {file.name} do not fit together, or exceed {MAX_BYTES:,} bytes")
        tensor.raw_data = content[start : start + length]
        tensor.ClearField("data_location")
        tensor.ClearField("external_data")
    if not files:
        return data
    return bytes(model.SerializeToString())


def _outside(model: Any) -> list[Any]:
    """Return the tensors whose numbers are in another file."""
    found = []
    for graph in _graphs(model):
        found += [tensor for tensor in _tensors(graph) if tensor.data_location == tensor.EXTERNAL]
    return found


def _beside(tensor: Any, path: Path) -> Path:
    """Return the file that holds the numbers of a tensor."""
    name = next((each.value for each in tensor.external_data if each.key == "location"), "")
    if name in ("", ".", "..") or re.search(r"[/\\:\0]", name):
        raise PerdureError(f"{path} keeps weights in {name[:100]!r}; only a file in the model's own folder is read")
    if not (path.parent / name).is_file():
        raise PerdureError(f"{path} keeps weights in {name}, which is not beside it: copy both files")
    return path.parent / name


def _read(path: str | Path) -> bytes:
    if not Path(path).exists():
        raise PerdureError(f"there is no file {path}")
    return read_bounded(path, MAX_BYTES)


def _parse(data: bytes, what: str) -> Any:
    import onnx
    from google.protobuf.message import DecodeError

    try:
        return onnx.load_model_from_string(data)
    except (DecodeError, ValueError, RecursionError):
        raise PerdureError(f"{what} is not an ONNX model, or its end is missing") from None


def _check(data: bytes, what: str) -> None:
    """Refuse what is no model, or needs code or files from elsewhere."""
    model = _parse(data, what)
    if not model.graph.node or not model.opset_import:
        raise PerdureError(f"{what} is not an ONNX model: it has no operators")
    own = {(each.domain, each.name) for each in model.functions}
    used: set[tuple[str, str]] = set()
    for graph in _graphs(model):
        used.update((node.domain, node.op_type) for node in graph.node)
    foreign = sorted({domain for domain, _ in used - own} - set(DOMAINS))
    if foreign:
        raise PerdureError(
            f"{what} uses operators of {', '.join(foreign)}, which onnxruntime has only with a library of their own; "
            "such libraries are not loaded"
        )
    if _outside(model):
        raise PerdureError(f"{what} keeps weights in another file: load it by its path (OnnxModel.load)")


def _graphs(model: Any) -> Iterator[Any]:
    """Yield the main graph, functions and the graphs inside operators."""
    waiting = [model.graph, *model.functions]
    while waiting:
        graph = waiting.pop()
        yield graph
        for node in graph.node:
            for attribute in node.attribute:
                if attribute.HasField("g"):
                    waiting.append(attribute.g)
                waiting += attribute.graphs


def _tensors(graph: Any) -> Iterator[Any]:
    yield from getattr(graph, "initializer", ())
    sparse = list(getattr(graph, "sparse_initializer", ()))
    for node in graph.node:
        for attribute in node.attribute:
            if attribute.HasField("t"):
                yield attribute.t
            yield from attribute.tensors
            if attribute.HasField("sparse_tensor"):
                sparse.append(attribute.sparse_tensor)
            sparse += attribute.sparse_tensors
    for each in sparse:
        yield from (each.values, each.indices)


# Export


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
    **{"add": "Add", "subtract": "Sub", "multiply": "Mul", "divide": "Div", "power": "Pow", "matmul": "MatMul"},
    **{"maximum": "Max", "minimum": "Min", "negative": "Neg", "greater": "Greater", "less": "Less"},
    **{"exp": "Exp", "tanh": "Tanh", "expit": "Sigmoid", "erf": "Erf"},
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
