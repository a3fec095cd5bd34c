"""Versions of libraries, which are part of an import's identity."""

from __future__ import annotations

from importlib.metadata import version


def library_versions() -> dict[str, str]:
    """Return the versions of the libraries that decide what an imported policy does in its reference episodes."""
    return {name: version(name) for name in ("perdure", "envpool", "gymnasium", "mujoco", "numpy")}
