"""Use any ONNX model as a function of observations."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from perdure.policy.errors import PolicyError, PolicyFileError

DOMAINS = ("", "ai.onnx", "ai.onnx.ml", "com.microsoft")
"""Operators that onnxruntime includes. Any other would need third-party code."""
TIMES = ("elapsed", "horizon")
"""Names of inputs that hold the time."""
ACTIONS = ("action", "actions")
"""Names of the action output if there are several outputs; else the first output is used."""
TRAINING_HORIZON = "perdure.training_horizon"
"""Metadata that `export_onnx` writes: steps."""
MAX_BYTES = 500_000_000


def require() -> None:
    """Raise PolicyError unless onnx and onnxruntime are installed."""
    missing = [name for name in ("onnx", "onnxruntime") if find_spec(name) is None]
    if missing:
        raise PolicyError(f"ONNX needs {' and '.join(missing)}: pip install 'perdure[onnx]'")


def is_onnx(path: str | Path) -> bool:
    """Return whether a file is named as an ONNX model is, in any case."""
    return str(path).lower().endswith(".onnx")


class OnnxModel:
    """A feed-forward model: observations in, actions out. Reading one runs none of its maker's code.

    Raises:
        PolicyFileError: If it is no ONNX model, needs operators or files that are not in it, or has other inputs than
            one observation and, perhaps, `elapsed` and `horizon`, or its metadata name no horizon of at least 1 step.
    """

    def __init__(self, data: bytes, what: str) -> None:
        """Load the model.

        Args:
            data: The file.
            what: Which file it is, for messages.
        """
        require()
        import onnxruntime

        _check(data, what)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4
        try:
            self._session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime's own kinds of error share no base
            raise PolicyFileError(f"{what} cannot be run by onnxruntime: {_one_line(error)}") from None
        inputs = {each.name: each for each in self._session.get_inputs()}
        self.times: tuple[str, ...] = tuple(name for name in TIMES if name in inputs)
        if boolean := [name for name in self.times if inputs[name].type == "tensor(bool)"]:
            raise PolicyFileError(f"{what}: the input {boolean[0]} must be a number of steps, not tensor(bool)")
        """Which inputs hold the time."""
        others = [each for name, each in inputs.items() if name not in TIMES]
        if len(others) != 1:
            raise PolicyFileError(
                f"{what} has the inputs {', '.join(inputs)}; expected are one observation and, for a time-to-go, "
                "elapsed and horizon"
            )
        self._input, self._what = others[0], what
        if self._input.shape and self._input.shape[0] == 0:
            raise PolicyFileError(f"{what} takes batches of 0 observations")
        self._dtype = _dtype(self._input.type)
        outputs = [each.name for each in self._session.get_outputs()]
        self._output = next((name for name in ACTIONS if name in outputs), outputs[0])
        self.__name__ = Path(what).stem
        self.training_horizon = _training_horizon(self._session.get_modelmeta().custom_metadata_map, what)
        """Steps of a training episode, if the model was exported with `export_onnx`; else None."""

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Return the model in a file.

        Raises:
            PolicyFileError: If there is no such file, or see the class.
        """
        path = Path(path)
        if not path.is_file():
            raise PolicyFileError(f"there is no file {path}")
        if path.stat().st_size > MAX_BYTES:
            raise PolicyFileError(f"{path} is larger than {MAX_BYTES:,} bytes")
        return cls(path.read_bytes(), str(path))

    def __call__(self, observations: Any, **times: NDArray[np.float64]) -> NDArray[Any]:
        """Return actions for a batch.

        Args:
            observations: Shape (n, *shape).
            times: `elapsed` and `horizon`, shape (n,), as far as the model has these inputs.

        Raises:
            PolicyError: If the model does not take such observations or times.
        """
        rows = self._shaped(np.asarray(observations))
        if set(times) != set(self.times):
            has = " and ".join(self.times) or "no time"
            raise PolicyError(f"{self._what} takes {has}, but was given {' and '.join(times) or 'no time'}")
        inputs = {each.name: each for each in self._session.get_inputs()}
        feed = {self._input.name: rows}
        feed |= {name: np.asarray(value, _dtype(inputs[name].type)) for name, value in times.items()}
        return np.concatenate([self._run(part) for part in _batches(feed, self._input.shape[0])])[: len(rows)]

    def _shaped(self, rows: NDArray[Any]) -> NDArray[Any]:
        """Return observations in the model's own shape and dtype."""
        wanted = [size if isinstance(size, int) else -1 for size in self._input.shape[1:]]
        given = rows.shape[1:]
        fits = len(given) == len(wanted) and all(a in (b, -1) for a, b in zip(wanted, given, strict=True))
        self._check_numbers(rows)
        try:
            return (rows if fits else rows.reshape(len(rows), *wanted)).astype(self._dtype)
        except ValueError:
            raise PolicyError(
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
            raise PolicyError(f"{self._what} takes observations of type {self._input.type}, which cannot hold these")

    def _run(self, feed: dict[str, NDArray[Any]]) -> NDArray[Any]:
        try:
            (actions,) = self._session.run([self._output], feed)
        except Exception as error:  # see above
            raise PolicyError(f"{self._what} failed: {_one_line(error)}") from None
        return np.asarray(actions)


def _batches(feed: dict[str, NDArray[Any]], size: Any) -> Iterator[dict[str, NDArray[Any]]]:
    """Yield the feed in batches of the size that the model asks for, the last one filled up; else all at once."""
    rows = len(next(iter(feed.values())))
    step = size if isinstance(size, int) else rows
    for first in range(0, rows, step):
        chosen = np.minimum(np.arange(first, first + step), rows - 1)
        yield {name: values[chosen] for name, values in feed.items()}


def _training_horizon(metadata: Mapping[str, str], what: str) -> int | None:
    text = metadata.get(TRAINING_HORIZON, "inf")
    try:
        steps = float(text)
    except ValueError:
        steps = math.nan
    if not steps >= 1.0:
        raise PolicyFileError(
            f"{what}: its metadata {TRAINING_HORIZON} is {text!r}; it is a number of steps, 1 or more"
        )
    return int(steps) if math.isfinite(steps) else None


def _dtype(kind: str) -> Any:
    """Return NumPy's type of "tensor(float)"."""
    names = {
        **{"float": np.float32, "double": np.float64, "float16": np.float16},
        **{"uint8": np.uint8, "int32": np.int32, "int64": np.int64, "bool": np.bool_},
    }
    name = kind.removeprefix("tensor(").rstrip(")")
    if name not in names:
        raise PolicyFileError(f"an input of type {kind} cannot hold observations; {', '.join(names)} can")
    return names[name]


def _check(data: bytes, what: str) -> None:
    """Refuse what is no model, or needs code or files from elsewhere."""
    import onnx
    from google.protobuf.message import DecodeError

    try:
        model = onnx.load_model_from_string(data)
    except (DecodeError, ValueError, RecursionError):
        raise PolicyFileError(f"{what} is not an ONNX model, or its end is missing") from None
    if not model.graph.node or not model.opset_import:
        raise PolicyFileError(f"{what} is not an ONNX model: it has no operators")
    domains = {node.domain for graph in _graphs(model) for node in graph.node}
    foreign = sorted((domains | {each.domain for each in model.opset_import}) - set(DOMAINS))
    if foreign:
        raise PolicyFileError(
            f"{what} uses operators of {', '.join(foreign)}, which onnxruntime has only with a library of their own; "
            "such libraries are not loaded"
        )
    external = onnx.TensorProto.EXTERNAL
    if any(tensor.data_location == external for graph in _graphs(model) for tensor in _tensors(graph)):
        raise PolicyFileError(f"{what} keeps weights in another file; save it as one file")


def _graphs(model: Any) -> Iterator[Any]:
    """Yield the main graph, functions and the graphs inside operators."""
    waiting = [model.graph, *model.functions]
    while waiting:
        graph = waiting.pop()
        yield graph
        for node in graph.node:
            for attribute in node.attribute:
                waiting += [attribute.g] if attribute.HasField("g") else []
                waiting += attribute.graphs


def _tensors(graph: Any) -> Iterator[Any]:
    yield from getattr(graph, "initializer", ())
    sparse = list(getattr(graph, "sparse_initializer", ()))
    for node in graph.node:
        for attribute in node.attribute:
            if attribute.HasField("t"):
                yield attribute.t
            yield from attribute.tensors
            sparse += [attribute.sparse_tensor] if attribute.HasField("sparse_tensor") else []
            sparse += attribute.sparse_tensors
    for each in sparse:
        yield from (each.values, each.indices)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:300]
