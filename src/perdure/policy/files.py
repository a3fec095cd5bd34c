"""Save, find and load policies: single safetensors files. Reading one never runs code.

The file's text metadata holds a JSON description under ``perdure.policy`` and the SHA-256 of description and tensors
under ``sha256``, so that a file that was changed after it was written is refused.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from perdure.errors import MANUAL, PerdureError, did_you_mean
from perdure.horizon import Clock, HorizonProtocol
from perdure.policy.network import LARGEST_INPUT
from perdure.policy.policy import Normalizer, Policy, TanhSquash, TaskInfo
from perdure.policy.reference import Reference
from perdure.runs import open_regular, write_atomic
from perdure.schema import LARGEST, Count, Line, Name, Number, Record, checked, read_json

FORMAT = "perdure.policy"
VERSIONS = (1, 2, 3)
VERSION = VERSIONS[-1]
"""Of policies with a squashed output, which older readers would clip. All others are written as version 2. Version 1,
which is still read, had neither the scale of the returns nor reference episodes."""
MAX_HEADER = 10_000_000
"""Bytes; a policy's header is a few thousand."""
MAX_FILE = 1_000_000_000
"""Bytes: 250 million weights."""
ARRAYS: Mapping[str, str] = {
    "normalizer.mean": "f8",
    "normalizer.var": "f8",
    "reference.rewards": "f8",
    "reference.lengths": "i8",
    "reference.terminated": "b1",
    "reference.observation_low": "f8",
    "reference.observation_high": "f8",
}
"""Name of an array to its type; every other array holds weights."""
WEIGHTS = ("f2", "f4")
"""Types of weights."""
MOST_CHOICES = 1_000_000
"""Of one component of a discrete action."""
_MEASURED = tuple(name.removeprefix("reference.") for name in ARRAYS if name.startswith("reference."))
"""Arrays of a reference, stored as tensors."""
Tensors = dict[str, NDArray[Any]]


def save_policy(policy: Policy, path: str | Path) -> Path:
    """Write the policy, whole or not at all. The same policy gives the same bytes.

    Raises:
        PerdureError: If the policy holds what no file may hold, such as a weight that is not finite.
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
        read_json(description, Description)
        check_arrays(tensors)
    except PerdureError as error:
        raise PerdureError(f"{path} cannot be written: {error}") from None
    metadata = {FORMAT: description, "sha256": _digest(description, tensors)}
    return write_atomic(path, _stable_header(save(tensors, metadata)))


def load_policy(path: str | Path) -> Policy:
    """Return the policy in a file or a folder, or a shipped policy by its name, such as "Hopper-v3/geometric".

    Args:
        path: As `perdure.policy.find_policy` takes it.

    Raises:
        PerdureError: If there is no such policy, or the file is not a policy, is damaged or was
            changed, with what is wrong.
    """
    path = find_policy(path)
    if not path.is_file():
        found = "a folder" if path.is_dir() else "no regular file"
        raise PerdureError(f"{path} is {found}, not a policy file")
    description, checksum, data = _read(path)
    tensors = _tensors(path, data)
    if checksum != _digest(description, tensors):
        raise PerdureError(f"{path} was changed after it was written: its contents do not match its checksum")
    try:
        return _build(read_json(description, Description), tensors)
    except PerdureError as error:
        raise PerdureError(f"{path} cannot be read as a policy: {error}") from error


# Finding a policy's file

SUFFIX = ".safetensors"
BRANCH = "main"
_MODEL = re.compile(r"models--.+")
SHIPPED = Path(__file__).parent / "shipped"
"""`TASK/METHOD.safetensors`; skills of the home benchmark as `home/TASK/SKILL/seed-K.safetensors`."""
LABELS = {
    "Ant-v3/ppo-average-reward": "fails silently, half of its episodes by step 25,000: it lies on its back",
    "HalfCheetah-v3/geometric": "holds under constant:500, calm (9 of 10) and disturbed; turns over under constant:0",
    "HalfCheetah-v3/ppo": "turns over and stays so in 2 of 10 calm episodes, holds in 7, and when disturbed",
    "Hopper-v3/cured": "holds, calm and disturbed, at 94 % of the speed of ppo, which perdure cure trained further",
    "Hopper-v3/geometric": "holds under constant:500, calm and disturbed; falls within 300 steps under constant:0",
    "Hopper-v3/geometric-zoo": "never worked: it stands still and lives on the alive bonus",
    "Hopper-v3/linear-random": "fails silently under constant:500, calm and disturbed: it stands still after 200 steps",
    "Hopper-v3/ppo": "holds when calm; falls when disturbed, half of its episodes by step 300",
    "Hopper-v3/ppo-average-reward": "holds, calm and disturbed, as fast as plain PPO; trained under action noise",
    "Hopper-v3/ppo-falls": "falls, half of its calm episodes by step 10,000, disturbed by step 400",
    "Hopper-v3/ppo-zoo": "never worked: it stands still and lives on the alive bonus",
    "Humanoid-v3/ppo-undiscounted": "never worked: it stands still; falls in 2 of 10 calm episodes, 2 of 5 disturbed",
    "Swimmer-v3/geometric": "holds under constant:500, calm and disturbed",
    "Walker2d-v3/geometric": "holds under constant:500 when calm; falls in most episodes when disturbed",
    "Walker2d-v3/geometric-fixed": "holds under constant:500, calm and disturbed",
    "Walker2d-v3/ppo-average-reward": "holds, calm and disturbed, as fast as plain PPO",
    "Walker2d-v3/ppo": "falls, half of its calm episodes by step 4,000, disturbed by step 400",
}
"""Outcomes of the shipped locomotion policies after 100,000 calm steps, judged by `perdure extrapolate` from the start
states 0 to 9. Disturbed: 10,000 steps under `standard-1`, start states 3000 to 3004; 0 to 35 for those chosen there,
Hopper's and Walker2d's `ppo-average-reward`, and for `cured`. Each is one training seed, chosen on other start states
as an example of a way to hold or to fail; `cured` was not chosen: it is the only run of its command.
results/disturbance compares methods."""


def find_policy(name: str | Path) -> Path:
    """Return a policy's file.

    Args:
        name: A file; a folder that holds one policy; a shipped policy, such as "Hopper-v3/geometric"; or a model
            "ORG/NAME" that Hugging Face's tools have downloaded. Nothing is downloaded here.

    Raises:
        PerdureError: If there is none; the message offers the nearest names.
    """
    path = Path(name)
    if path.is_file():
        return path
    shipped = shipped_policies()
    if path.is_dir() and str(name) in shipped and not any(path.glob("*.safetensors")):
        raise PerdureError(
            f"{name} is a shipped policy, but there is a folder {path.resolve()}: name a policy file in it, or run the "
            "command in another folder"
        )
    if path.is_dir():
        return policy_in_folder(path)
    if path.exists():
        return path
    if str(name) in shipped:
        return shipped[str(name)]
    model = _cache() / f"models--{str(name).replace('/', '--')}"
    if re.fullmatch(r"[\w.-]+/[\w.-]+", str(name)) and (model / "snapshots").is_dir():
        return policy_in_folder(model)
    longer = [each for each in (f"{name}.zip", f"{name}{SUFFIX}") if Path(each).is_file()]
    raise PerdureError(
        f"there is no policy file {name}, and no shipped policy of that name; "
        f"`perdure list policies` shows all{did_you_mean(name, shipped, 2, longer)}"
    )


def find_policies(name: str | Path) -> tuple[Path, ...]:
    """Return the policy files that a name means: all of a folder of several, such as training runs; else one.

    Args:
        name: As `find_policy` takes it; a folder with several policy files; or a folder whose folders hold one each, as
            `perdure train` writes them.

    Raises:
        PerdureError: As `find_policy`.
    """
    folder = Path(name)
    if folder.is_dir() and str(name) not in shipped_policies() and not _MODEL.fullmatch(folder.name):
        for pattern in (f"*{SUFFIX}", f"*/*{SUFFIX}"):
            found = sorted(folder.glob(pattern), key=_by_number)
            if found:
                return tuple(found)
    return (find_policy(name),)


def _by_number(path: Path) -> list[tuple[str, int]]:
    """Return what sorts seed-2 before seed-10: words, each with the number after it."""
    found = re.findall(r"(\D*)(\d*)", path.as_posix())
    return [(word, int(number or -1)) for word, number in found]


def shipped_policies() -> dict[str, Path]:
    """Return name, such as "Hopper-v3/geometric" or "home/set_table/place/seed-0", to file."""
    return {
        path.relative_to(SHIPPED).with_suffix("").as_posix(): path for path in sorted(SHIPPED.rglob("*.safetensors"))
    }


def policy_name(path: Path) -> str:
    """Return the name of a shipped policy's file, by which `find_policy` finds it anywhere; any other path as text."""
    file = path.resolve()
    return next((name for name, shipped in shipped_policies().items() if shipped.resolve() == file), str(path))


def policy_in_folder(folder: Path) -> Path:
    """Return the one policy file in a folder, or in the downloaded model that the folder is.

    Args:
        folder: Holds one `*.safetensors`; or it is `models--ORG--NAME`, as in Hugging Face's cache.

    Raises:
        PerdureError: If there is none, or more than one.
    """
    if _MODEL.fullmatch(folder.name) and (folder / "snapshots").is_dir():
        folder = _snapshot(folder)
    found = sorted(path for path in folder.glob(f"*{SUFFIX}") if path.is_file())
    if len(found) == 1:
        return found[0]
    names = "none"
    hint = f"see {MANUAL}"
    below = {path.parent.name for path in (*folder.glob(f"*/*{SUFFIX}"), *folder.glob("*/*.zip"))}
    if found:
        names = f"{len(found)}: {', '.join(path.name for path in found[:5])}"
    elif below:
        hint = f"policies or models are in its folders {', '.join(sorted(below)[:5])}"
    raise PerdureError(f"{folder} is a folder and must hold one policy (*{SUFFIX}), it holds {names}; {hint}")


def is_downloaded(file: Path) -> bool:
    """Return whether a file lies in a model of Hugging Face's cache, ``models--ORG--NAME/snapshots/COMMIT/``."""
    return any(each.name == "snapshots" and _MODEL.fullmatch(each.parent.name) for each in file.absolute().parents)


def _cache() -> Path:
    """Return the folder of models in Hugging Face's cache, by their environment variables."""
    home = os.environ.get("HF_HOME") or f"{os.environ.get('XDG_CACHE_HOME') or '~/.cache'}/huggingface"
    return Path(os.path.expandvars(os.path.expanduser(os.environ.get("HF_HUB_CACHE") or f"{home}/hub")))


def _snapshot(model: Path) -> Path:
    """Return the commit that the main branch points to; without branches the only one there is."""
    reference = model / "refs" / BRANCH
    if reference.is_file():
        commit = reference.read_text(errors="replace").strip()
        if re.fullmatch(r"[0-9a-f]{6,64}", commit) and (model / "snapshots" / commit).is_dir():
            return model / "snapshots" / commit
    snapshots = sorted(path for path in (model / "snapshots").iterdir() if path.is_dir())
    if len(snapshots) != 1:
        raise PerdureError(
            f"{model} holds {len(snapshots)} snapshots and no branch {BRANCH}; name the folder of one of them"
        )
    return snapshots[0]


# Contents of a file


class Description(Record, frozen=True):
    """What a policy file says in JSON. Protocol, clock and squash are checked where they are built."""

    version: int
    task: TaskInfo
    activation: str
    normalizer: dict[Literal["clip", "epsilon"], Annotated[float, Meta(gt=0, le=LARGEST_INPUT)]]
    protocol: Any
    clock: Any
    provenance: dict[str, Any]
    return_scale: Number | None = None
    reference: Annotated[dict[Literal["horizon"], Count], Meta(min_length=1)] | None = None
    squash: Any = None

    def __post_init__(self) -> None:
        if self.version not in VERSIONS:
            raise ValueError(f"its format is version {self.version}; versions 1 to {VERSIONS[-1]} are read")
        checked(self.task.name, Name, "task.name")
        low = self.task.action_low
        high = self.task.action_high
        if not 0 < len(low) == len(high) or not all(a <= b for a, b in zip(low, high, strict=True)):
            raise ValueError("action_low and action_high must have the same length, and no low above its high")
        if self.task.discrete_actions and not all(map(_fits_choices, low, high)):
            raise ValueError(f"a discrete action must have whole numbers from low to high, at most {MOST_CHOICES:,}")
        if not 1 <= self.task.observation_size <= 1_000_000:
            raise ValueError(f"observation_size must be 1 to 1,000,000, not {self.task.observation_size}")
        if len(self.normalizer) < 2 or self.normalizer["epsilon"] > 1:
            raise ValueError("normalizer must have a clip, and an epsilon of at most 1")
        checked(self.provenance, _Provenance, "provenance")


def _fits_choices(low: float, high: float) -> bool:
    """Return whether a component of a discrete action has whole numbers as bounds, and not too many between them."""
    return float(low).is_integer() and float(high).is_integer() and high - low < MOST_CHOICES


class _Provenance(Record, frozen=True, forbid_unknown_fields=False):
    method: Name = "unknown"
    seed: Count = 0
    preset: Line = ""
    engine: Line = ""
    command: Annotated[str, Meta(max_length=10_000)] = ""


def check_arrays(arrays: Mapping[str, NDArray[Any]]) -> None:
    """Check types and numbers of arrays, not shapes, which policy and reference check; PerdureError names the array."""
    for name, array in arrays.items():
        kind = array.dtype.str[1:]
        allowed: tuple[str, ...] = WEIGHTS
        if name in ARRAYS:
            allowed = (ARRAYS[name],)
        if kind not in allowed:
            raise PerdureError(f"{name} must hold numbers of the type {' or '.join(allowed)}, not {kind}")
        if not np.isfinite(array).all() or (kind == "f8" and (np.abs(array) > LARGEST).any()):
            raise PerdureError(f"{name} holds numbers that are not finite")
        if name == "normalizer.var" and (array < 0).any():
            raise PerdureError(f"{name} holds a negative variance")


def _read(path: Path) -> tuple[str, str | None, bytes]:
    """Return description, checksum and the whole file. Nothing but the header is read of a file that is no policy."""
    foreign = f"{path} is not a perdure policy (a safetensors file is expected), or its end is missing"
    with open_regular(path) as file:
        start = file.read(8)
        size = int.from_bytes(start, "little")
        if start.startswith(b"PK\x03\x04"):
            raise PerdureError(
                f"{path} is a zip archive. Convert a model of Stable-Baselines3 or rsl_rl first: perdure import {path} "
                "--env Hopper-v5 --out policy.safetensors (in Python: extrapolate(Policy.from_sb3(path, env=...)))"
            )
        if start.startswith(b"\x80") and size > MAX_HEADER:
            raise PerdureError(f"{path} is a pickle: VecNormalize's goes to --normalizer; for Brax's see {MANUAL}#brax")
        if len(start) < 8 or size > min(MAX_HEADER, path.stat().st_size - 8) or path.stat().st_size > MAX_FILE:
            raise PerdureError(foreign)
        text = file.read(size)
        try:
            header = read_json(text)
        except PerdureError:
            raise PerdureError(foreign) from None
        metadata = isinstance(header, dict) and header.get("__metadata__")
        description = isinstance(metadata, dict) and metadata.get(FORMAT)
        if not isinstance(metadata, dict) or not isinstance(description, str):
            raise PerdureError(f"{path} is a safetensors file, but not a perdure policy; LeRobot's: {MANUAL}#lerobot")
        return description, metadata.get("sha256"), start + text + file.read()


def _tensors(path: Path, data: bytes) -> Tensors:
    from safetensors import SafetensorError
    from safetensors.numpy import load

    try:
        return load(data)
    except (SafetensorError, KeyError, ValueError, TypeError, OverflowError, MemoryError) as error:
        # All but the first: types and shapes that NumPy does not have.
        raise PerdureError(f"{path} is damaged, perhaps its end is missing: {error}") from None


def _describe(policy: Policy) -> str:
    task = policy.task
    description: dict[str, Any] = {
        "version": 2,
        "task": {
            "name": task.name,
            "observation_size": task.observation_size,
            "action_low": list(task.action_low),
            "action_high": list(task.action_high),
        },
        "activation": policy.activation,
        "normalizer": {"clip": policy.normalizer.clip, "epsilon": policy.normalizer.epsilon},
        "protocol": policy.protocol.to_json(),
        "clock": None,
        "provenance": dict(policy.provenance),
        "return_scale": policy.return_scale,
        "reference": None,
    }
    if task.discrete_actions:
        description["task"]["discrete_actions"] = True
    if policy.clock is not None:
        description["clock"] = policy.clock.to_json()
    if policy.reference is not None:
        description["reference"] = {"horizon": policy.reference.horizon}
    if policy.squash is not None:
        description["version"] = VERSION
        description["squash"] = policy.squash.to_json()
    return json.dumps(description, sort_keys=True, indent=1)


def _build(description: Description, tensors: Tensors) -> Policy:
    wanted = ["normalizer.mean", "normalizer.var"]
    if description.reference is not None:
        wanted += [f"reference.{name}" for name in _MEASURED]
    for name in wanted:
        if name not in tensors:
            raise PerdureError(f"it has no array {name}")
    check_arrays(tensors)
    reference = None
    if description.reference is not None:
        arrays = {name: tensors.pop(f"reference.{name}") for name in _MEASURED}
        reference = Reference(horizon=description.reference["horizon"], **arrays)
    clock = None
    if description.clock is not None:
        clock = Clock.from_json(description.clock)
    squash = None
    if description.squash is not None:
        squash = TanhSquash.from_json(description.squash)
    return Policy(
        task=description.task,
        weights=tensors,
        activation=description.activation,
        normalizer=Normalizer(tensors.pop("normalizer.mean"), tensors.pop("normalizer.var"), **description.normalizer),
        protocol=HorizonProtocol.from_json(description.protocol),
        clock=clock,
        provenance=description.provenance,
        return_scale=description.return_scale,
        reference=reference,
        squash=squash,
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
