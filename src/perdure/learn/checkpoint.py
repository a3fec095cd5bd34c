"""The state of a training run, between two segments or within one (`partial.py`), with its file.

The file is one safetensors file. Reading one never runs code. Every array of the state is stored under its path in the
tree, such as ``learner/params/policy.0.weight``. What a learner adds to its state is stored without a change here.
"""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from perdure.errors import PerdureError
from perdure.runs import write_atomic
from perdure.schema import Count, Record, read_json

FORMAT = "perdure.checkpoint"
VERSION = "4"
HEADER = ("seed", "segment", "iteration")
"""Fields of the state that are plain numbers."""
GROWING = ("episodes", "iterations", "sent/actions", "sent/done", "observation_std")
"""Arrays of the state with a row for each episode, iteration or step so far."""


class _Header(Record, frozen=True):
    version: str
    seed: Count
    segment: Count
    iteration: Count = 0


StateT = TypeVar("StateT", bound="RunState")


@dataclass(frozen=True)
class RunState:
    """One seed's run after ``segment`` segments."""

    seed: int
    segment: int
    """Segments finished."""
    learner: Any
    """The learner's state, a tree of arrays."""
    episodes: NDArray[np.float64]
    """One row for each training episode that ended, shape (episodes, columns)."""
    iterations: NDArray[np.float64]
    """One row for each iteration, shape (iterations, columns)."""


def save_checkpoint(state: RunState, path: Path) -> None:
    """Write the state, whole or not at all."""
    from safetensors.numpy import save

    leaves, _ = jax.tree_util.tree_flatten_with_path(_tree(state))
    arrays = {_name(where): np.array(leaf, order="C") for where, leaf in leaves}
    numbers = {name: getattr(state, name) for name in HEADER if hasattr(state, name)}
    header = json.dumps({"version": VERSION, **numbers})
    write_atomic(path, save(arrays, {FORMAT: header}))


def checkpoint_place(path: Path) -> tuple[int, int]:
    """Return the finished segments that a checkpoint keeps, and the iterations of the whole run where it is within one.

    Its arrays are not read. Zeros where there is no file that can be read.
    """
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="numpy") as file:
            header: _Header = read_json((file.metadata() or {}).get(FORMAT, ""), _Header)
    except (SafetensorError, OSError, PerdureError):  # what is wrong is said by the run that loads it
        return 0, 0
    return header.segment, header.iteration


def load_checkpoint(path: Path, start: StateT) -> StateT:
    """Read the state back, bit for bit.

    Args:
        path: The file.
        start: The state before the first segment of the same run, or at the beginning of the same segment, which says
            what arrays there are.

    Raises:
        PerdureError: If the file is damaged, of another version, or of another run.
    """
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="numpy") as file:
            header: _Header = read_json((file.metadata() or {}).get(FORMAT, ""), _Header)
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no dictionary
    except (SafetensorError, KeyError, ValueError, TypeError, OverflowError, MemoryError) as error:
        # Of NumPy: types and shapes that NumPy does not have.
        raise PerdureError(f"{path} is not a readable checkpoint ({error}); remove it to start afresh") from error
    if header.version != VERSION:
        raise PerdureError(
            f"{path} is of version {header.version}; this perdure reads version {VERSION}; remove it to start afresh"
        )
    if header.seed != start.seed:
        raise PerdureError(
            f"{path} is the checkpoint of seed {header.seed}, not of {start.seed}; remove it to start afresh"
        )
    leaves, structure = jax.tree_util.tree_flatten_with_path(_tree(start))
    names = [_name(where) for where, _ in leaves]
    if sorted(names) != sorted(arrays):
        odd = ", ".join(sorted(set(names) ^ set(arrays)))
        raise PerdureError(f"{path} is the checkpoint of another run (differs in {odd}); remove it to start afresh")
    for name, (_, leaf) in zip(names, leaves, strict=True):
        if not _alike(arrays[name], leaf, name):
            raise PerdureError(
                f"{path} is the checkpoint of another run ({name} has type {arrays[name].dtype} and shape "
                f"{arrays[name].shape}); remove it to start afresh"
            )
    with jax.enable_x64(True):
        read = [
            arrays[name] if isinstance(leaf, np.ndarray) else jnp.asarray(arrays[name])
            for name, (_, leaf) in zip(names, leaves, strict=True)
        ]
    tree = jax.tree_util.tree_unflatten(structure, read)
    numbers = {name: getattr(header, name) for name in HEADER if hasattr(start, name)}
    return dataclasses.replace(start, **numbers, **tree)


def _alike(read: Any, start: Any, name: str) -> bool:
    """Return whether an array has dtype and shape of its initial value; some grow by rows."""
    known = np.asarray(start)
    grows = name in GROWING and read.ndim == known.ndim
    return bool(
        read.dtype == known.dtype and (grows or read.shape == known.shape) and read.shape[1:] == known.shape[1:]
    )


def _tree(state: RunState) -> dict[str, Any]:
    """Return the fields that hold arrays."""
    return {each.name: getattr(state, each.name) for each in dataclasses.fields(state) if each.name not in HEADER}


def _name(where: tuple[Any, ...]) -> str:
    """Return a path in the tree as words between slashes."""
    return "/".join(str(getattr(key, "key", getattr(key, "name", getattr(key, "idx", key)))) for key in where)
