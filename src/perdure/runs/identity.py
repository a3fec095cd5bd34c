"""Identity of a unit: a readable key, the SHA-256 of its config, and the digest of the source code that made it."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from perdure.errors import PerdureError
from perdure.runs.files import open_regular, write_atomic
from perdure.schema import Record, read_json

PACKAGE = Path(__file__).parents[1]
RECORD = "unit.json"
"""The file inside every unit that says what the unit is."""
_PART = re.compile(r"[A-Za-z0-9_(][A-Za-z0-9._+=,@()-]*")
_LONGEST_KEY = 200
_SHOWN = 6


class Identity(Record, frozen=True, rename={"digest": "sha256"}):
    """One unit: a readable key and the config that belongs to it; `unit.json` holds these fields."""

    key: str
    """Parts joined by "/", e.g. "Hopper-v3/geometric/seed-0"."""
    config: dict[str, Any]
    """JSON values only."""
    digest: str
    """SHA-256 of the config as canonical JSON, in hexadecimal."""
    sources: tuple[str, ...] = ()
    """Digests of the source codes that made the unit, where the record says so. No part of what a unit is."""

    @classmethod
    def of(cls, key: str, config: Mapping[str, Any]) -> Identity:
        """Check the key, bring the config to plain JSON values and compute its digest.

        Raises:
            PerdureError: The key leaves the store or is not readable, or the config holds something JSON cannot.
        """
        check_key(key)
        text = canonical_json(config, f"the config of {key!r}")
        try:
            return cls(key, read_json(text), hashlib.sha256(text.encode()).hexdigest())
        except PerdureError as error:  # before the work: its record could not be read again
            raise PerdureError(f"{key!r} cannot be stored: {error}") from error

    def write(self, folder: Path) -> None:
        """Write the record of this unit into `folder`; add the digest of the current source code to earlier ones."""
        sources = {source_digest()}
        if (folder / RECORD).is_file():
            sources.update(Identity.read(folder).sources)
        record = {"key": self.key, "sha256": self.digest, "config": self.config, "sources": sorted(sources)}
        write_atomic(folder / RECORD, json.dumps(record, indent=2, sort_keys=True) + "\n")

    @classmethod
    def read(cls, folder: Path) -> Identity:
        """Read the record in `folder`.

        Raises:
            PerdureError: The record is damaged, or was edited so that its digest no longer fits.
        """
        path = folder / RECORD
        try:
            identity: Identity = read_json(path.read_bytes(), cls)
            fits = cls.of(identity.key, identity.config).digest == identity.digest
        except (FileNotFoundError, PerdureError) as error:
            raise PerdureError(f"{path} is damaged: {error}") from error
        if not fits:
            raise PerdureError(f"{path} was changed after it was written: its config does not fit its SHA-256.")
        return identity

    def check_same(self, other: Identity, where: str) -> None:
        """Refuse `other` (what was asked for) unless it is this unit (what is stored).

        Raises:
            PerdureError: With the fields that differ.
        """
        if self.key != other.key:
            raise PerdureError(f"{where} holds the unit {self.key!r}, not {other.key!r}.")
        if self.digest != other.digest:
            fields = describe_difference(self.config, other.config)
            raise PerdureError(
                f"{other.key!r} is in {where} with another config: {fields}. "
                "Choose another name or folder, or remove this unit's."
            )


def config_digest(config: Mapping[str, Any]) -> str:
    """Return the SHA-256, in hexadecimal, of `config` as canonical JSON (sorted keys, no spaces).

    Raises:
        PerdureError: The config holds something JSON cannot.
    """
    return hashlib.sha256(canonical_json(config, "the config").encode()).hexdigest()


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a regular file as hexadecimal digits."""
    with open_regular(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def versions(*packages: str) -> dict[str, str]:
    """Return the installed version of perdure and of each of these packages, by name."""
    return {name: version(name) for name in ("perdure", *packages)}


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


def check_key(key: str) -> str:
    """Return `key` when it is readable and stays inside the store.

    Raises:
        PerdureError: Otherwise, with what a key may be.
    """
    readable = isinstance(key, str) and len(key) <= _LONGEST_KEY
    if not readable or not all(_PART.fullmatch(part) and part != RECORD for part in key.split("/")):
        raise PerdureError(
            f"{key!r} cannot be a unit's key: use parts of letters, digits and . _ + = , @ ( ) - joined by '/', "
            f'none of them starting with a dot or a dash, such as "Hopper-v3/geometric/seed-0".'
        )
    return key


def canonical_json(config: Mapping[str, Any], name: str) -> str:
    """Return `config` as JSON text that depends on its content only.

    Raises:
        PerdureError: Something in it is no JSON value (NaN and infinity are none either); the sentence calls it `name`.
    """
    if not isinstance(config, Mapping):
        raise PerdureError(f"{name} must be a mapping, not {type(config).__name__}.")
    for field, value in flatten(config):
        if not isinstance(value, str | int | float | bool | None):
            raise PerdureError(f"{name} has {field} = {value!r} ({type(value).__name__}), which JSON cannot hold.")
        if isinstance(value, float) and not math.isfinite(value):
            raise PerdureError(f'{name} has {field} = {value}, which JSON cannot hold: write it as text, e.g. "inf".')
    return json.dumps(config, sort_keys=True, separators=(",", ":"), ensure_ascii=True, default=dict)


def describe_difference(stored: Mapping[str, Any], asked: Mapping[str, Any]) -> str:
    """Return the fields in which two configs differ, with both values, as text."""
    old = dict(flatten(stored))
    new = dict(flatten(asked))
    fields = [field for field in sorted(old | new) if _show(old, field) != _show(new, field)]
    shown = [f"{field} is {_show(old, field)} there and {_show(new, field)} here" for field in fields[:_SHOWN]]
    if len(fields) > _SHOWN:
        shown.append(f"{len(fields) - _SHOWN} more fields")
    return ", ".join(shown)


def flatten(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield (dotted name, value) of every leaf; an empty mapping or list is a leaf too, the text "{}" or "[]"."""
    if name and not value and isinstance(value, Mapping | list | tuple):
        yield name, "{}" if isinstance(value, Mapping) else "[]"
    elif isinstance(value, Mapping):
        for key, item in value.items():
            if not isinstance(key, str):
                raise PerdureError(f"the config has the key {key!r} under {name or 'its top'}: keys must be text.")
            yield from flatten(item, f"{name}.{key}" if name else key)
    elif isinstance(value, list | tuple):
        for index, item in enumerate(value):
            yield from flatten(item, f"{name}[{index}]")
    else:
        yield name, value


def _show(fields: Mapping[str, Any], field: str) -> str:
    if field in fields:
        return repr(fields[field])
    return "not set"
