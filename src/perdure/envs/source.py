"""Digest of a user's environment code: cached results depend on it."""

from __future__ import annotations

import hashlib
from importlib.util import find_spec
from pathlib import Path

from perdure.envs.suites import module_of


def source_digest(task: str) -> dict[str, str]:
    """Return {module: SHA-256} of the module that "gymnasium:MODULE:Id" imports; {} for other tasks.

    For a module inside a package, all Python files of the top-level package are included. Code that it imports from
    other packages is not.
    """
    top = (module_of(task) or "").partition(".")[0]
    try:
        spec = find_spec(top) if top else None
    except (ImportError, ValueError):
        spec = None
    if spec is None or spec.origin is None or not Path(spec.origin).is_file():
        return {}
    origin = Path(spec.origin)
    folder = origin.parent if spec.submodule_search_locations else None
    files = sorted(folder.rglob("*.py")) if folder else [origin]
    digest = hashlib.sha256()
    for file in files:
        name = file.relative_to(folder).as_posix() if folder else file.name
        data = file.read_bytes()
        digest.update(f"{name}\0{len(data)}\0".encode() + data)
    return {top: digest.hexdigest()}
