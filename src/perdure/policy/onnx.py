"""Policies as ONNX models: export with `export_onnx`, run a model of any maker with `OnnxModel`.

This module reads their files, which strangers may have made: it runs nothing, bounds their size, and finds the weights
that lie in files beside them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from perdure.errors import PerdureError
from perdure.runs import config_digest, file_digest, read_bounded

if TYPE_CHECKING:
    from perdure.policy.onnx_export import export_onnx
    from perdure.policy.onnx_model import OnnxModel

__all__ = ["OnnxModel", "export_onnx", "is_onnx", "metadata", "model_digest"]

DOMAINS = ("", "ai.onnx", "ai.onnx.ml", "com.microsoft")
"""Operators that onnxruntime includes. Any other would need third-party code."""
MAX_BYTES = 500_000_000
"""Of a model with the weights beside it."""


def __getattr__(name: str) -> object:
    """Load what runs and what exports models only at its first use."""
    if name == "OnnxModel":
        from perdure.policy import onnx_model

        return onnx_model.OnnxModel
    if name == "export_onnx":
        from perdure.policy import onnx_export

        return onnx_export.export_onnx
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def is_onnx(path: str | Path) -> bool:
    """Return whether a file is named as an ONNX model is, in any case."""
    return str(path).lower().endswith(".onnx")


def require() -> None:
    """Raise PerdureError unless onnx and onnxruntime are installed."""
    missing = [name for name in ("onnx", "onnxruntime") if find_spec(name) is None]
    if missing:
        raise PerdureError(f"ONNX needs {' and '.join(missing)}: pip install 'perdure[onnx]'")


@contextmanager
def refusing(what: str) -> Iterator[None]:
    """Raise whatever a damaged model makes onnx and onnxruntime raise as PerdureError: their errors share no base."""
    try:
        yield
    except PerdureError:
        raise
    except Exception as error:
        text = " ".join(str(error).split())[:300]
        raise PerdureError(f"{what} cannot be run by onnxruntime: {text or type(error).__name__}") from None


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
    with refusing(str(path)):
        beside = sorted({_beside(tensor, path) for tensor in _outside(_parse(_read(path), str(path)))})
    if not beside:
        return file_digest(path)
    return config_digest({"files": [file_digest(each) for each in (path, *beside)]})


def read_whole(path: Path) -> bytes:
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


def check_model(data: bytes, what: str) -> None:
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
