"""Load models with Stable-Baselines3 itself, which runs the code pickled in them: for files that the user trusts."""

from __future__ import annotations

import contextlib
import pickle
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import numpy as np

from perdure.errors import PerdureError
from perdure.policy.readers.restricted_pickle import ZipMembers
from perdure.policy.readers.sb3 import MAX_FILE as MAX_ZIP
from perdure.policy.readers.sb3 import MAX_SETTINGS, USE_A_FUNCTION, Sb3Model, read_gym, read_layers, read_settings
from perdure.policy.readers.sb3_import import MAX_FILE, Statistics, checked_normalizer
from perdure.runs import read_bounded

PACKAGES = {
    **dict.fromkeys(("PPO", "A2C", "SAC", "TD3", "DQN"), "stable_baselines3"),
    **dict.fromkeys(("TQC", "TRPO", "QRDQN", "ARS"), "sb3_contrib"),
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
        members = ZipMembers(read_bounded(path, MAX_ZIP), what)
        settings = read_settings(members.read("data", MAX_SETTINGS), what)
        if settings.algorithm not in PACKAGES:
            raise PerdureError(f"{path} is not a model of {', '.join(PACKAGES)}: {USE_A_FUNCTION}")
        algorithm = getattr(import_module(PACKAGES[settings.algorithm]), settings.algorithm)
        tensors = algorithm.load(what, device="cpu").policy.state_dict()
        state = {name: each.detach().cpu().numpy().astype(np.float32) for name, each in tensors.items()}
        layers = read_layers(list(state), state.__getitem__, settings, what)
        return Sb3Model(settings, layers, import_module("stable_baselines3").__version__, read_gym(members))


def load_vecnormalize(path: Path) -> Statistics:
    """Return the statistics of a VecNormalize. Runs the code in the file; PerdureError if it is none."""
    what = str(path)
    with _named(what):
        import_module("stable_baselines3")
        saved = pickle.loads(read_bounded(path, MAX_FILE))
        if not saved.norm_obs:
            return Statistics(None, float(saved.gamma))
        parts = [saved.obs_rms]
        if isinstance(saved.obs_rms, dict):
            parts = [saved.obs_rms[name] for name in sorted(saved.obs_rms)]
        mean = np.concatenate([np.asarray(each.mean, np.float64).ravel() for each in parts])
        var = np.concatenate([np.asarray(each.var, np.float64).ravel() for each in parts])
        normalizer = checked_normalizer(mean, var, float(saved.clip_obs), float(saved.epsilon), what)
        return Statistics(normalizer, float(saved.gamma), float(parts[0].count))


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
