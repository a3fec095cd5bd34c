"""Parts that readers of deployment files share, and the reader of the metadata in an ONNX file."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from perdure.errors import PerdureError
from perdure.policy.onnx import metadata
from perdure.robots.readers import DeploymentReader, Reading, from_metadata, parse_yaml
from perdure.robots.terms import term_name
from perdure.runs import read_bounded

LARGEST_FILE = 1_000_000
"""Bytes of a file that is read."""


class PolicyMetadata(DeploymentReader):
    """See `words`."""

    name = "metadata"
    words = "metadata in the ONNX file of mjlab and holosoma"
    suffixes = (".onnx",)

    def reading(self, path: Path, robot: Mapping[str, Any]) -> Reading:
        """See `DeploymentReader.reading`."""
        return Reading(from_metadata(metadata(path)))


# Parts of readers


def top_level_names(path: Path) -> set[str]:
    """Return the names at the top of a YAML file, without reading the rest; empty if it cannot be read."""
    try:
        data = read_bounded(path, LARGEST_FILE)
    except (OSError, PerdureError):
        return set()
    return {name.decode() for name in re.findall(rb"^([A-Za-z_]\w*)\s*:", data, re.MULTILINE)}


@contextmanager
def as_written_by(authors: str) -> Iterator[None]:
    """Raise what a table of another form makes Python raise as PerdureError."""
    try:
        yield
    except PerdureError:
        raise
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError, re.error) as error:
        found = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
        raise PerdureError(f"it is not as {authors} writes it ({found})") from None


def foreign_yaml(path: Path) -> dict[str, Any]:
    """Return a YAML file as plain values; tags of Python are ignored, and nothing of them runs."""
    return parse_yaml(read_bounded(path, LARGEST_FILE), foreign=True)


def numbers(values: Any) -> list[float]:
    """Return a list as floats; TypeError if it is none."""
    return [float(each) for each in values]


def one_or_all(values: Any) -> Any:
    """Return the one number that a list repeats, else the list; a number as it is."""
    if not isinstance(values, list | tuple):
        return float(values)
    found = numbers(values)
    if len(set(found)) == 1:
        return found[0]
    return found


def matched(values: Any, joints: Sequence[str], default: float | None = None) -> list[float] | None:
    """Return one number for each joint of a number or of a table from regular expressions; None if one has none."""
    if not isinstance(values, Mapping):
        return [float(values)] * len(joints)
    found = []
    for joint in joints:
        fitting = [float(number) for pattern, number in values.items() if re.fullmatch(str(pattern), joint)]
        if not fitting and default is None:
            return None
        found.append(fitting[0] if fitting else float(default or 0.0))
    return found


def observation(name: str, scale: Any, clip: Any, history: int, scale_first: bool = False) -> dict[str, Any]:
    """Return an observation term as a contract writes it, with its own name where it has one.

    Raises:
        PerdureError: If a clip that comes after several scales cannot be written as one before them.
    """
    term: dict[str, Any] = {"name": term_name(name) or name}
    factor = 1.0
    if scale is not None:
        factor = one_or_all(scale)
    if factor != 1.0:
        term["scale"] = factor
    if clip is not None:
        low, high = numbers(clip)
        if scale_first and (not isinstance(factor, float) or factor <= 0.0):
            raise PerdureError(f"{name} is clipped after its scale {factor}")
        if scale_first and isinstance(factor, float):
            low /= factor
            high /= factor
        term["clip"] = [low, high]
    if history > 1:
        term["history"] = history
    return term
