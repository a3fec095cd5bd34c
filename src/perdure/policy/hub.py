"""Find policies in folders: your own, or the cache of Hugging Face's tools.

Nothing is downloaded here. `huggingface-cli download ORG/NAME` and `snapshot_download` leave
``models--ORG--NAME/snapshots/COMMIT/`` behind, with the commit of each branch in ``refs/``.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from perdure.policy.errors import PolicyFileError

SUFFIX = ".safetensors"
BRANCH = "main"
_MODEL = re.compile(r"models--.+")


def policy_in_folder(folder: Path) -> Path:
    """Return the one policy file in a folder, or in the downloaded model that the folder is.

    Args:
        folder: Holds one `*.safetensors`; or it is `models--ORG--NAME`, as in Hugging Face's cache.

    Raises:
        PolicyFileError: If there is none, or more than one.
    """
    if _MODEL.fullmatch(folder.name) and (folder / "snapshots").is_dir():
        folder = _snapshot(folder)
    found = sorted(path for path in folder.glob(f"*{SUFFIX}") if path.is_file())
    if len(found) == 1:
        return found[0]
    names = f"{len(found)}: {', '.join(path.name for path in found[:5])}" if found else "none"
    raise PolicyFileError(f"{folder} is a folder and must hold one policy (*{SUFFIX}), it holds {names}")


def policy_in_cache(name: str) -> Path | None:
    """Return the policy of a downloaded model `ORG/NAME`; None if that is no such name or was not downloaded.

    Raises:
        PolicyFileError: If the model is there, but holds no policy or more than one.
    """
    if not re.fullmatch(r"[\w.-]+/[\w.-]+", name):
        return None
    folder = _cache() / f"models--{name.replace('/', '--')}"
    return policy_in_folder(folder) if (folder / "snapshots").is_dir() else None


def is_downloaded(file: Path) -> bool:
    """Return whether a file lies in a model of Hugging Face's cache, ``models--ORG--NAME/snapshots/COMMIT/``."""
    return any(each.name == "snapshots" and _MODEL.fullmatch(each.parent.name) for each in file.absolute().parents)


def _cache() -> Path:
    """Return the folder of models in Hugging Face's cache, by their environment variables."""
    if cache := os.environ.get("HF_HUB_CACHE"):
        return _expanded(cache)
    if home := os.environ.get("HF_HOME"):
        return _expanded(home) / "hub"
    return _expanded(os.environ.get("XDG_CACHE_HOME") or "~/.cache") / "huggingface" / "hub"


def _expanded(path: str) -> Path:
    return Path(os.path.expandvars(os.path.expanduser(path)))


def _snapshot(model: Path) -> Path:
    """Return the commit that the main branch points to; without branches the only one there is."""
    reference = model / "refs" / BRANCH
    if reference.is_file():
        commit = reference.read_text(errors="replace").strip()
        if re.fullmatch(r"[0-9a-f]{6,64}", commit) and (model / "snapshots" / commit).is_dir():
            return model / "snapshots" / commit
    snapshots = sorted(path for path in (model / "snapshots").iterdir() if path.is_dir())
    if len(snapshots) != 1:
        raise PolicyFileError(
            f"{model} holds {len(snapshots)} snapshots and no branch {BRANCH}; name the folder of one of them"
        )
    return snapshots[0]
