"""Save and load policies as single safetensors files. Reading one never runs code.

The file's text metadata holds a JSON description under ``perdure.policy`` and the SHA-256 of description and tensors
under ``sha256``, so that a file that was changed after it was written is refused.
"""

from __future__ import annotations

import hashlib
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perdure.horizon import HorizonError, HorizonProtocol, clock_from_json
from perdure.policy.errors import PolicyError, PolicyFileError
from perdure.policy.policy import Normalizer, Policy
from perdure.policy.reference import Reference
from perdure.policy.schema import DESCRIPTION, VERSIONS, check_arrays
from perdure.policy.shipped import find_policy
from perdure.policy.squash import TanhSquash
from perdure.policy.task import TaskInfo
from perdure.runs import write_atomic
from perdure.schema import SchemaError, read_json

FORMAT = "perdure.policy"
VERSION = VERSIONS[-1]
"""Of policies with a squashed output, which older readers would clip. All others are written as version 2. Version 1,
which is still read, had neither the scale of the returns nor reference episodes."""
MAX_HEADER = 10_000_000
"""Bytes; a policy's header is a few thousand."""

_MEASURED = ("rewards", "lengths", "terminated", "observation_low", "observation_high")
"""Arrays of a reference, stored as tensors."""

Tensors = dict[str, NDArray[Any]]


def save_policy(policy: Policy, path: str | Path) -> Path:
    """Write the policy, whole or not at all. The same policy gives the same bytes.

    Raises:
        PolicyFileError: If the policy holds what no file may hold, such as a weight that is not finite.
        OSError: If the file cannot be written; an old one is untouched.
    """
    from safetensors.numpy import save

    tensors: Tensors = {name: np.ascontiguousarray(policy.weights[name]) for name in sorted(policy.weights)}
    tensors["normalizer.mean"] = policy.normalizer.mean
    tensors["normalizer.var"] = policy.normalizer.var
    if policy.reference is not None:
        tensors |= {f"reference.{name}": np.ascontiguousarray(getattr(policy.reference, name)) for name in _MEASURED}
    description = _describe(policy)
    try:
        DESCRIPTION.check(json.loads(description))
        check_arrays(tensors)
    except SchemaError as error:
        raise PolicyFileError(f"{path} cannot be written: {error}") from None
    metadata = {FORMAT: description, "sha256": _digest(description, tensors)}
    write_atomic(Path(path), _stable_header(save(tensors, metadata)))
    return Path(path)


def load_policy(path: str | Path) -> Policy:
    """Return the policy in a file or a folder, or a shipped policy by its name, such as "Hopper-v3/geometric".

    Args:
        path: As `perdure.policy.find_policy` takes it.

    Raises:
        PolicyFileError: If there is no such policy, or the file is not a policy, is damaged or was
            changed, with what is wrong.
    """
    path = find_policy(path)
    if not path.is_file():
        raise PolicyFileError(f"{path} is {'a folder' if path.is_dir() else 'no regular file'}, not a policy file")
    description, checksum, data = _read(path)
    tensors = _tensors(path, data)
    if checksum != _digest(description, tensors):
        raise PolicyFileError(f"{path} was changed after it was written: its contents do not match its checksum")
    try:
        return _build(read_json(description), tensors)
    except (SchemaError, HorizonError, PolicyError) as error:
        raise PolicyFileError(f"{path} cannot be read as a policy: {error}") from error


def _read(path: Path) -> tuple[str, str | None, bytes]:
    """Return description, checksum and the whole file. Nothing but the header is read of a file that is no policy."""
    foreign = f"{path} is not a perdure policy (a safetensors file is expected), or its end is missing"
    with path.open("rb") as file:
        start = file.read(8)
        size = int.from_bytes(start, "little")
        if start.startswith(b"PK\x03\x04"):
            raise PolicyFileError(
                f"{path} is a zip archive. Convert a model of Stable-Baselines3 first: perdure import {path} "
                "--env Hopper-v5 --out policy.safetensors (in Python: Policy.from_sb3(path, env=...))"
            )
        if len(start) < 8 or size > min(MAX_HEADER, path.stat().st_size - 8):
            raise PolicyFileError(foreign)
        text = file.read(size)
        try:
            header = read_json(text)
        except SchemaError:
            raise PolicyFileError(foreign) from None
        metadata = header.get("__metadata__") if isinstance(header, dict) else None
        description = metadata.get(FORMAT) if isinstance(metadata, dict) else None
        if not isinstance(metadata, dict) or not isinstance(description, str):
            raise PolicyFileError(f"{path} is a safetensors file, but not a perdure policy")
        checksum = metadata.get("sha256")
        return description, checksum, start + text + file.read()


def _tensors(path: Path, data: bytes) -> Tensors:
    from safetensors import SafetensorError
    from safetensors.numpy import load

    try:
        return load(data)
    except (SafetensorError, KeyError, ValueError, TypeError, OverflowError, MemoryError) as error:
        # All but the first: types and shapes that NumPy does not have.
        raise PolicyFileError(f"{path} is damaged, perhaps its end is missing: {error}") from None


def _describe(policy: Policy) -> str:
    task = policy.task
    description = {
        "version": 2 if policy.squash is None else VERSION,
        "task": {
            "name": task.name,
            "observation_size": task.observation_size,
            "action_low": list(task.action_low),
            "action_high": list(task.action_high),
        },
        "activation": policy.activation,
        "normalizer": {"clip": policy.normalizer.clip, "epsilon": policy.normalizer.epsilon},
        "protocol": policy.protocol.to_json(),
        "clock": None if policy.clock is None else policy.clock.to_json(),
        "provenance": dict(policy.provenance),
        "return_scale": policy.return_scale,
        "reference": None if policy.reference is None else {"horizon": policy.reference.horizon},
    }
    if policy.squash is not None:
        description["squash"] = policy.squash.to_json()
    return json.dumps(description, sort_keys=True, indent=1)


def _build(description: Any, tensors: Tensors) -> Policy:
    version = description.get("version") if isinstance(description, dict) else None
    if type(version) is int and version not in VERSIONS:
        raise PolicyError(f"its format is version {version}; this perdure reads versions 1 to {VERSION}")
    DESCRIPTION.check(description)
    reference = description.get("reference")
    wanted = ["normalizer.mean", "normalizer.var", *(f"reference.{name}" for name in _MEASURED if reference)]
    if missing := [name for name in wanted if name not in tensors]:
        raise PolicyError(f"it has no array {missing[0]}")
    check_arrays(tensors)
    measured = None
    if reference is not None:
        arrays = {name: tensors.pop(f"reference.{name}") for name in _MEASURED}
        measured = Reference(horizon=reference["horizon"], **arrays)
    task = description["task"]
    normalizer = Normalizer(tensors.pop("normalizer.mean"), tensors.pop("normalizer.var"), **description["normalizer"])
    clock, squash = description["clock"], description.get("squash")
    return Policy(
        task=TaskInfo(task["name"], task["observation_size"], tuple(task["action_low"]), tuple(task["action_high"])),
        weights=tensors,
        activation=description["activation"],
        normalizer=normalizer,
        protocol=HorizonProtocol.from_json(description["protocol"]),
        clock=None if clock is None else clock_from_json(clock),
        provenance=description["provenance"],
        return_scale=description.get("return_scale"),
        reference=measured,
        squash=None if squash is None else TanhSquash.from_json(squash),
    )


def _digest(description: str, tensors: Tensors) -> str:
    digest = hashlib.sha256(description.encode(errors="surrogatepass"))
    for name in sorted(tensors):
        array = np.ascontiguousarray(tensors[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def _stable_header(data: bytes) -> bytes:
    """Return the same file with its metadata in sorted order: safetensors writes it in the order of a hash table."""
    (size,) = struct.unpack("<Q", data[:8])
    header = json.loads(data[8 : 8 + size])
    text = json.dumps({"__metadata__": dict(sorted(header.pop("__metadata__").items())), **header}).encode()
    text += b" " * (-len(text) % 8)
    return struct.pack("<Q", len(text)) + text + data[8 + size :]
