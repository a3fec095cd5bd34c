"""Load models with Stable-Baselines3 itself, which runs the code pickled in them: for files that the user trusts."""

from __future__ import annotations

import contextlib
import pickle
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perdure.errors import PerdureError
from perdure.policy.readers.sb3 import (
    ACTOR_CRITIC,
    DEFAULT_ACTIVATION,
    FLATTEN_EXTRACTOR,
    TORCH_ACTIVATIONS,
    USE_A_FUNCTION,
    Sb3Model,
    Sb3Settings,
    algorithm_of,
    read_layers,
    squash_of,
)
from perdure.policy.readers.sb3_import import MAX_FILE, Statistics, checked_normalizer
from perdure.runs import open_regular, read_bounded

PACKAGES = {
    **dict.fromkeys(("PPO", "A2C", "SAC", "TD3"), "stable_baselines3"),
    **dict.fromkeys(("TQC", "TRPO"), "sb3_contrib"),
}
"""Algorithm to the package that has it."""
INSTALL = "--trust needs Stable-Baselines3: pip install stable-baselines3 sb3-contrib"


def load_sb3(path: Path) -> Sb3Model:
    """Return the deterministic policy in a zip, loaded by Stable-Baselines3. Runs the code in the file.

    Raises:
        PerdureError: If Stable-Baselines3 is not installed, cannot load the file, or holds a policy of a kind that
            is not read.
    """
    what = str(path)
    with _named(what):
        model = _load(path)
        settings = _settings(model, what)
        state = _TorchTensors(model.policy.state_dict())
        return Sb3Model(settings, read_layers(state, settings, what), import_module("stable_baselines3").__version__)


def load_vecnormalize(path: Path) -> Statistics:
    """Return the statistics of a VecNormalize, loaded by pickle. Runs the code in the file.

    Raises:
        PerdureError: If Stable-Baselines3 is not installed, or the file is no VecNormalize.
    """
    what = str(path)
    with _named(what):
        import_module("stable_baselines3")
        saved = pickle.loads(read_bounded(path, MAX_FILE))
        if not saved.norm_obs:
            return Statistics(None, float(saved.gamma))
        mean, var = (np.asarray(each, np.float64).ravel() for each in (saved.obs_rms.mean, saved.obs_rms.var))
        normalizer = checked_normalizer(mean, var, float(saved.clip_obs), float(saved.epsilon), what)
        return Statistics(normalizer, float(saved.gamma))


class _TorchTensors:
    """Tensors of a state dict as arrays."""

    def __init__(self, tensors: Any) -> None:
        self._tensors = tensors

    @property
    def names(self) -> list[str]:
        return list(self._tensors)

    def array(self, name: str) -> NDArray[np.float32]:
        array: NDArray[np.float32] = self._tensors[name].detach().cpu().numpy().astype(np.float32)
        if not np.isfinite(array).all():
            raise PerdureError(f"the weights {name!r} hold numbers that are not finite")
        return array


@contextlib.contextmanager
def _named(what: str) -> Iterator[None]:
    """Convert errors of third-party code to one line that names the file."""
    try:
        yield
    except (PerdureError, OSError):
        raise
    except ImportError as error:
        missing = (error.name or "").partition(".")[0]
        if missing in ("", "stable_baselines3", "sb3_contrib", "torch"):
            raise PerdureError(f"{what}: {INSTALL} ({error})") from None
        raise PerdureError(f"{what} needs the Python module {missing}, which is not installed ({error})") from None
    except Exception as error:
        raise PerdureError(f"{what}: Stable-Baselines3 cannot load it: {type(error).__name__}: {error}") from error


def _load(path: Path) -> Any:
    open_regular(path).close()
    settings = import_module("stable_baselines3.common.save_util").load_from_zip_file(str(path), device="cpu")[0]
    algorithm = algorithm_of(settings)
    if algorithm not in PACKAGES:
        raise PerdureError(f"{path} is not a model of {', '.join(PACKAGES)}: {USE_A_FUNCTION}")
    return getattr(import_module(PACKAGES[algorithm]), algorithm).load(str(path), device="cpu")


def _settings(model: Any, what: str) -> Sb3Settings:
    policy = model.policy
    actor = getattr(policy, "actor", policy)
    function, extractor = policy.activation_fn, getattr(actor, "features_extractor", None)
    own = function.__module__ == "torch.nn.modules.activation"
    activation = TORCH_ACTIVATIONS.get(function.__name__) if own else None
    module = type(policy).__module__
    if activation is None or module not in DEFAULT_ACTIVATION:
        raise PerdureError(f"{what}: {module} with {function.__name__} is not read: {USE_A_FUNCTION}")
    seen, space = model.observation_space, model.action_space
    image = len(seen.shape or ()) == 3 and seen.dtype == np.uint8
    if type(seen).__name__ != "Box" or image:
        kind = "image" if image else type(seen).__name__
        raise PerdureError(f"{what} is for {kind} observations; only vectors (Box) are read: {USE_A_FUNCTION}")
    if str(type(extractor)) != FLATTEN_EXTRACTOR:
        raise PerdureError(
            f"{what}: its features extractor is {type(extractor).__name__}, which is not read: {USE_A_FUNCTION}"
        )
    return Sb3Settings(
        algorithm=type(model).__name__,
        policy_module=module,
        activation=activation,
        squash=squash_of(
            module, bool(policy.squash_output), bool(model.use_sde), float(getattr(actor, "clip_mean", 0.0))
        ),
        action_bounds=(space.low.ravel().astype(np.float64), space.high.ravel().astype(np.float64)),
        gamma=float(model.gamma),
        behind_vecnormalize=module == ACTOR_CRITIC and model._last_original_obs is not None,
        shows_vecnormalize=module == ACTOR_CRITIC and model._last_obs is not None,
        seed=model.seed,
        steps=model.num_timesteps,
    )
