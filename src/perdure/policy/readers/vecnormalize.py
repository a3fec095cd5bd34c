"""Read observation statistics of Stable-Baselines3's `VecNormalize` without running its pickle."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perdure.policy.errors import PolicyFileError
from perdure.policy.policy import LARGEST_OBSERVATION, SMALLEST_EPSILON, Normalizer
from perdure.policy.readers.inert_pickle import Call, read_pickle
from perdure.policy.readers.numpy_arrays import NUMPY_NAMES, read_numbers

MAX_FILE = 64_000_000
"""Bytes; statistics of 100 numbers take 3,000."""
VEC_NORMALIZE = "stable_baselines3.common.vec_env.vec_normalize.VecNormalize"
RUNNING_MEAN_STD = "stable_baselines3.common.running_mean_std.RunningMeanStd"
_SPACES = {
    f"{library}.spaces.{space}"
    for library in ("gym", "gymnasium")
    for space in ("box.Box", "dict.Dict", "discrete.Discrete")
}
_RANDOM = {
    *(f"numpy.random._pickle.{name}" for name in ("__generator_ctor", "__bit_generator_ctor", "__randomstate_ctor")),
    *("numpy.random._pcg64.PCG64", "numpy.random._mt19937.MT19937", "numpy.random.bit_generator.SeedSequence"),
    "numpy.random.bit_generator.__pyx_unpickle_SeedSequence",
}
ALLOWED = {VEC_NORMALIZE, RUNNING_MEAN_STD, "collections.OrderedDict", *NUMPY_NAMES, *_SPACES, *_RANDOM}
"""What the pickle of a VecNormalize asks for: itself, statistics, arrays, spaces and their random generators."""


@dataclass(frozen=True, eq=False)
class Statistics:
    """Observation statistics of a VecNormalize."""

    normalizer: Normalizer | None
    """None if it normalizes rewards only."""
    gamma: float
    """Discount of the running return whose spread scaled the rewards."""


def read_vecnormalize(path: Path) -> Statistics:
    """Return the statistics that `VecNormalize.save` wrote to a file.

    Raises:
        PolicyFileError: If the file is damaged, is something else, asks for functions that a VecNormalize does not
            need, or holds statistics that are not finite.
        OSError: If it cannot be read.
    """
    if path.stat().st_size > MAX_FILE:
        raise PolicyFileError(f"{path} has {path.stat().st_size:,} bytes; at most {MAX_FILE:,} are read")
    saved = read_pickle(path.read_bytes(), ALLOWED, str(path))
    if not (isinstance(saved, Call) and saved.function == VEC_NORMALIZE and isinstance(saved.state, dict)):
        raise PolicyFileError(f"{path} is not a saved VecNormalize of Stable-Baselines3")
    return _statistics(saved.state, str(path))


def _statistics(state: dict[Any, Any], what: str) -> Statistics:
    gamma = _single(state, "gamma", what)
    if state.get("norm_obs") is False:
        return Statistics(None, gamma)
    statistics = state.get("obs_rms")
    if isinstance(statistics, dict):
        raise PolicyFileError(f"{what} is for observations that are a dictionary, which are not read")
    if not (isinstance(statistics, Call) and isinstance(statistics.state, dict)):
        raise PolicyFileError(f"{what} holds no observation statistics")
    mean, var = (_number(statistics.state, name, what).ravel() for name in ("mean", "var"))
    clip, epsilon = (_single(state, name, what) for name in ("clip_obs", "epsilon"))
    return Statistics(checked_normalizer(mean, var, clip, epsilon, what), gamma)


def checked_normalizer(
    mean: NDArray[np.float64], var: NDArray[np.float64], clip: float, epsilon: float, what: str
) -> Normalizer:
    """Return a normalizer of these statistics.

    Raises:
        PolicyFileError: If they do not fit together, are not finite or have a negative variance.
    """
    fits = mean.shape == var.shape and np.isfinite(mean).all() and np.isfinite(var).all()
    if not fits or not (var + epsilon > 0).all() or not (clip > 0 and 0 <= epsilon < np.inf):
        raise PolicyFileError(f"{what} holds statistics that are not finite, negative variances or a clip of 0")
    return Normalizer(mean, var, min(clip, LARGEST_OBSERVATION), max(epsilon, SMALLEST_EPSILON))


def _single(state: dict[Any, Any], name: str, what: str) -> float:
    found = _number(state, name, what)
    if found.size != 1:
        raise PolicyFileError(f"{what}: {name} must be one number, but there are {found.size}")
    return float(found.item())


def _number(state: dict[Any, Any], name: str, what: str) -> NDArray[np.float64]:
    if name not in state:
        raise PolicyFileError(f"{what} has no {name}")
    return read_numbers(state[name], f"{what}: {name}")
