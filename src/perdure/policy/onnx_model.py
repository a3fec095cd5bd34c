"""`OnnxModel`: run an ONNX model of any maker as a policy."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from perdure.errors import MANUAL, PerdureError
from perdure.policy.onnx import check_model, read_whole, refusing, require
from perdure.policy.reference import LONGEST_HORIZON

if TYPE_CHECKING:
    from perdure.envs import TaskSpec

Arrays = dict[str, NDArray[Any]]
"""Arrays by the names of a model's inputs."""
TIMES = ("elapsed", "horizon")
"""Names of inputs that hold the time."""
ACTIONS = ("action", "actions", "continuous_actions")
"""Names of the action output if there are several outputs; else the first output is used."""
TRAINING_HORIZON = "perdure.training_horizon"
"""Metadata that `export_onnx` writes: steps."""


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
        with refusing(what):
            self._open(data, what)
        self._thread: ThreadPoolExecutor | None = None
        if b"Loop" in data:  # the only operator that may not end
            self._thread = ThreadPoolExecutor(1)

    def _open(self, data: bytes, what: str) -> None:
        import onnxruntime

        check_model(data, what)
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
        return {
            "inputs": _shapes_text(self._session.get_inputs()),
            "outputs": _shapes_text(self._session.get_outputs()),
            "state": ", ".join(self.state) or "none",
            "action": self._outputs[0],
        }

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Return the model in a file, with the weights in files beside it.

        Raises:
            PerdureError: If there is no such file, or see the class.
        """
        require()
        with refusing(str(path)):
            data = read_whole(Path(path))
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

        with refusing(self._what):
            if self._thread is None:
                return rows()
            try:
                job = self._thread.submit(rows)
                while not job.done():
                    wait([job], 0.5)  # without a limit, an interruption that another thread gets would wait too
                return job.result()
            finally:
                options.terminate = True


def _shapes_text(values: Sequence[Any]) -> str:
    return ", ".join(f"{each.name} {each.shape}" for each in values)


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
        "float": np.float32,
        "double": np.float64,
        "float16": np.float16,
        "uint8": np.uint8,
        "int32": np.int32,
        "int64": np.int64,
        "bool": np.bool_,
    }
    name = kind.removeprefix("tensor(").rstrip(")")
    if name not in names:
        raise PerdureError(f"an input of type {kind} cannot hold observations; {', '.join(names)} can")
    return names[name]
