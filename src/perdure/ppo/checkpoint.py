"""Training state as one safetensors file, written whole after every segment. Reading one never runs code."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from perdure.ppo.errors import CheckpointError
from perdure.ppo.normalizer import RunningMoments
from perdure.ppo.rollout import Statistics
from perdure.ppo.state import SeedState
from perdure.ppo.update import AdamState
from perdure.runs import write_whole

FORMAT = "perdure.checkpoint"
VERSION = "1"


def save_checkpoint(state: SeedState, path: Path) -> None:
    """Writes the state, whole or not at all."""
    from safetensors.numpy import save

    arrays: dict[str, NDArray[Any]] = {"episodes": state.episodes, "iterations": state.iterations}
    arrays |= {f"params/{name}": np.asarray(value) for name, value in state.params.items()}
    arrays |= {f"adam.first/{name}": np.asarray(value) for name, value in state.adam.first.items()}
    arrays |= {f"adam.second/{name}": np.asarray(value) for name, value in state.adam.second.items()}
    arrays["adam.count"] = np.asarray(state.adam.count)[None]
    for name, moments in zip(("observations", "returns"), state.statistics, strict=True):
        arrays |= {f"{name}.{part}": np.atleast_1d(np.asarray(getattr(moments, part))) for part in moments._fields}
    header = json.dumps({"version": VERSION, "seed": state.seed, "segment": state.segment})
    write_whole(path, save({k: np.ascontiguousarray(v) for k, v in arrays.items()}, {FORMAT: header}))


def load_checkpoint(path: Path) -> SeedState:
    """Reads the state back, bit for bit.

    Raises:
        CheckpointError: If the file is damaged or of another version.
    """
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="numpy") as file:
            header = json.loads((file.metadata() or {})[FORMAT])
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no dictionary
    except (SafetensorError, KeyError, json.JSONDecodeError) as error:
        raise CheckpointError(f"{path} is not a readable checkpoint ({error}); remove it to start afresh") from error
    if header["version"] != VERSION:
        raise CheckpointError(f"{path} is of version {header['version']}; this perdure reads version {VERSION}")
    with jax.enable_x64(True):
        return SeedState(
            seed=header["seed"],
            segment=header["segment"],
            params=_group(arrays, "params"),
            adam=AdamState(
                _group(arrays, "adam.first"), _group(arrays, "adam.second"), jnp.asarray(arrays["adam.count"][0])
            ),
            statistics=Statistics(_moments(arrays, "observations"), _moments(arrays, "returns")),
            episodes=arrays["episodes"],
            iterations=arrays["iterations"],
        )


def _group(arrays: dict[str, NDArray[Any]], prefix: str) -> dict[str, jax.Array]:
    return {
        name.removeprefix(f"{prefix}/"): jnp.asarray(value)
        for name, value in arrays.items()
        if name.startswith(f"{prefix}/")
    }


def _moments(arrays: dict[str, NDArray[Any]], name: str) -> RunningMoments:
    return RunningMoments(
        jnp.asarray(arrays[f"{name}.mean"]), jnp.asarray(arrays[f"{name}.var"]), jnp.asarray(arrays[f"{name}.count"][0])
    )
