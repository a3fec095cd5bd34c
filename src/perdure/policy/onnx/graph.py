"""Build an ONNX graph with Python operators.

Embeddings and clocks are written with operators only, so that one body serves NumPy and traced JAX arrays. The same
body, given a `Value`, leaves its nodes in a graph: a third-party embedding is exported without ONNX code.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

OPSET = 17
IR_VERSION = 8
"""Of onnx 1.12 (2022): what runtimes on robots read as well."""


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
        return Value(self, name, np.ndim(array))

    def node(self, kind: str, *inputs: Any, ndim: int | None = None, **attributes: Any) -> Value:
        """Add an operator.

        Args:
            kind: Name of the operator.
            inputs: Values; arrays and numbers become constants.
            ndim: Dimensions of the result; by default the most that an input has.
            attributes: Of the operator.
        """
        from onnx import helper

        values = [each if isinstance(each, Value) else self.constant(each) for each in inputs]
        name = f"{kind.lower()}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, [value.name for value in values], [name], **attributes))
        return Value(self, name, max(value.ndim for value in values) if ndim is None else ndim)

    def cast(self, value: Value, dtype: type[np.generic]) -> Value:
        """Convert a value to another type of number."""
        from onnx import helper

        return self.node("Cast", value, to=helper.np_dtype_to_tensor_dtype(np.dtype(dtype)))


@dataclass(frozen=True, eq=False)
class Value:
    """A tensor of 64-bit numbers in a graph, with as much of NumPy's interface as embeddings and clocks use."""

    graph: Graph
    name: str
    ndim: int

    __array_ufunc__ = None  # NumPy's arrays leave their operators with a value to it

    def _with(self, kind: str, other: Any, swapped: bool = False, **attributes: Any) -> Value:
        operand = other if isinstance(other, Value) else np.asarray(other, np.float64)
        pair = (operand, self) if swapped else (self, operand)
        return self.graph.node(kind, *pair, **attributes)

    def __add__(self, other: Any) -> Value:
        return self._with("Add", other)

    __radd__ = __add__

    def __mul__(self, other: Any) -> Value:
        return self._with("Mul", other)

    __rmul__ = __mul__

    def __sub__(self, other: Any) -> Value:
        return self._with("Sub", other)

    def __rsub__(self, other: Any) -> Value:
        return self._with("Sub", other, swapped=True)

    def __truediv__(self, other: Any) -> Value:
        return self._with("Div", other)

    def __rtruediv__(self, other: Any) -> Value:
        return self._with("Div", other, swapped=True)

    def __mod__(self, other: Any) -> Value:
        return self._with("Mod", other, fmod=1)  # C's fmod, which is Python's % where nothing is negative

    def __pow__(self, other: Any) -> Value:
        return self._with("Pow", other)

    def __rpow__(self, other: Any) -> Value:
        return self._with("Pow", other, swapped=True)

    def __neg__(self) -> Value:
        return self.graph.node("Neg", self)

    def __gt__(self, other: Any) -> Value:
        return self.graph.cast(self._with("Greater", other), np.float64)

    def __lt__(self, other: Any) -> Value:
        return self.graph.cast(self._with("Less", other), np.float64)

    def __getitem__(self, index: Any) -> Value:
        """Add a last dimension, the one index that embeddings use."""
        if index != (..., None):
            raise TypeError(f"only [..., None] can be written in ONNX here, not [{index!r}]")
        axes: NDArray[np.int64] = np.array([-1])
        return self.graph.node("Unsqueeze", self, axes, ndim=self.ndim + 1)

    def clip(self, min: float | None = None, max: float | None = None) -> Value:
        """Clip to a range, like NumPy's method."""
        result = self if min is None else self._with("Max", min)
        return result if max is None else result._with("Min", max)
