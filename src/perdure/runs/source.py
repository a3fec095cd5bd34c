"""Digest of the source code that made a unit: results of another source version are reused with a warning."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parents[1]


@cache
def source_digest(package: Path = PACKAGE) -> str:
    """Return the SHA-256, in hexadecimal, of the names and contents of all Python files in the folder `package`.

    It is that of the files when it is first asked for. Comments count: a digest that knew better would differ from one
    version of Python to the next.
    """
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        content = path.read_bytes()
        digest.update(f"{path.relative_to(package).as_posix()} {len(content)}\n".encode() + content)
    return digest.hexdigest()
