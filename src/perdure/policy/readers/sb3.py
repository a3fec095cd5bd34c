"""Read a Stable-Baselines3 or sb3-contrib zip without these libraries, without PyTorch and without running its code."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from perdure.policy.errors import PolicyFileError
from perdure.policy.readers.sb3_data import ACTOR_CRITIC, SAC, TD3, TQC, USE_A_FUNCTION, Sb3Settings, read_settings
from perdure.policy.readers.torch_state import TorchState
from perdure.policy.readers.zip_members import ZipMembers

MAX_FILE = 1_000_000_000
"""Bytes of the zip."""
MAX_SETTINGS = 64_000_000
"""Bytes of its settings, unpacked; they may hold the last observations."""
MAX_WEIGHTS = 512_000_000
"""Bytes of its weights, unpacked."""
MAX_LAYERS = 32
_LAYER = r"\.(\d+)\.(?:weight|bias)"

Layer = tuple[NDArray[np.float32], NDArray[np.float32]]
"""Weight (in, out) and bias (out,)."""


class State(Protocol):
    """Named weights."""

    @property
    def names(self) -> list[str]:
        """All names."""

    def array(self, name: str) -> NDArray[np.float32]:
        """Return the weights of that name."""


@dataclass(frozen=True, eq=False)
class Sb3Model:
    """Contents of a zip that a policy needs."""

    settings: Sb3Settings
    layers: list[Layer]
    """From observation to action."""
    version: str
    """Of the Stable-Baselines3 that wrote it; "" if unknown."""


def read_sb3(path: Path) -> Sb3Model:
    """Return the deterministic policy in a zip that `model.save` wrote.

    Raises:
        PolicyFileError: If the zip is damaged, too large or holds a policy of a kind that is not read.
        OSError: If it cannot be read.
    """
    what = str(path)
    if path.stat().st_size > MAX_FILE:
        raise PolicyFileError(f"{what} has {path.stat().st_size:,} bytes; at most {MAX_FILE:,} are read")
    members = ZipMembers(path.read_bytes(), what)
    settings = read_settings(members.read("data", MAX_SETTINGS), what)
    state = TorchState(members.read("policy.pth", MAX_WEIGHTS), f"{what}: policy.pth")
    version = "_stable_baselines3_version"
    written = members.read(version, 100).decode("ascii", "replace") if version in members.names else ""
    return Sb3Model(settings, read_layers(state, settings, what), written if re.fullmatch(r"[\w.]+", written) else "")


def read_layers(state: State, settings: Sb3Settings, what: str) -> list[Layer]:
    """Return the layers between observation and action.

    Raises:
        PolicyFileError: If the network has other parts than a perceptron, or layers do not fit together.
    """
    names = _layer_names(state.names, settings, what)
    if len(names) > MAX_LAYERS:
        raise PolicyFileError(f"{what} has {len(names)} layers; at most {MAX_LAYERS} are read")
    layers = [(state.array(f"{name}.weight"), state.array(f"{name}.bias")) for name in names]
    size: int | None = None
    for name, (weight, bias) in zip(names, layers, strict=True):
        if weight.ndim != 2 or bias.shape != weight.shape[:1] or size not in (None, weight.shape[1]):
            raise PolicyFileError(f"{what}: layer {name!r} does not fit the layer before it")
        size = weight.shape[0]
    return [(np.ascontiguousarray(weight.T), bias) for weight, bias in layers]


def _layer_names(names: list[str], settings: Sb3Settings, what: str) -> list[str]:
    if settings.policy_module == ACTOR_CRITIC:
        known = rf"mlp_extractor\.(shared_net|policy_net|value_net){_LAYER}|(action|value)_net\.(weight|bias)|log_std"
        layers = [*_numbered(names, "mlp_extractor.shared_net"), *_numbered(names, "mlp_extractor.policy_net")]
        layers.append("action_net")
    elif settings.policy_module in (SAC, TQC):
        known = rf"actor\.latent_pi{_LAYER}|actor\.(mu|log_std)(\.0)?\.(weight|bias)|actor\.log_std|critic.*"
        layers = [*_numbered(names, "actor.latent_pi"), "actor.mu.0" if "actor.mu.0.weight" in names else "actor.mu"]
    else:
        assert settings.policy_module == TD3
        known = rf"actor\.mu{_LAYER}|(actor_target|critic).*"
        layers = list(_numbered(names, "actor.mu"))
    unknown = [name for name in names if not re.fullmatch(known, name)]
    if unknown or not layers:
        part = "".join(letter for letter in unknown[0][:80] if letter.isprintable()) if unknown else "no layers"
        raise PolicyFileError(f"{what}: its policy is not a plain perceptron, it has {part!r}: {USE_A_FUNCTION}")
    return layers


def _numbered(names: list[str], prefix: str) -> Iterator[str]:
    """Yield PREFIX.0, PREFIX.2, ...: between them stand the activation functions, which have no weights."""
    found = {
        int(match[1]) for name in names if (match := re.fullmatch(rf"{re.escape(prefix)}\.(\d{{1,4}})\.weight", name))
    }
    for place in sorted(found):
        yield f"{prefix}.{place}"


def is_sb3_zip(path: Path) -> bool:
    """Return whether a file is meant to be a model of Stable-Baselines3: named .zip, or a zip archive."""
    if path.suffix.lower() == ".zip":
        return True
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(4) == b"PK\x03\x04"
