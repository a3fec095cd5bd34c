"""Identity of an import: the contents of files and the versions of libraries."""

from __future__ import annotations

import hashlib
from importlib.metadata import version
from pathlib import Path


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file as hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def library_versions() -> dict[str, str]:
    """Return the versions of the libraries that decide what an imported policy does in its reference episodes."""
    return {name: version(name) for name in ("perdure", "envpool", "gymnasium", "mujoco", "numpy")}
