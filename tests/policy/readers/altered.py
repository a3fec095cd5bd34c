"""Altered models, for tests of what is refused."""

from __future__ import annotations

import io
import json
import pickle
import zipfile
from pathlib import Path

FIXTURES = Path(__file__).parent / "fixtures"


def rebuilt(data, changes, compression=zipfile.ZIP_STORED):
    """The zip archive `data` with members replaced; a function is given the old contents, None removes a member."""
    written = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(written, "w", compression) as new:
        for name in [*old.namelist(), *(set(changes) - set(old.namelist()))]:
            change = changes.get(name, lambda contents: contents)
            contents = change(old.read(name) if name in old.namelist() else b"") if callable(change) else change
            if contents is not None:
                new.writestr(name, contents)
    return written.getvalue()


def model(name="ppo"):
    """The bytes of a model."""
    return (FIXTURES / f"{name}.zip").read_bytes()


def with_settings(change, name="ppo"):
    """A model whose settings `change` has altered in place."""

    def changed(contents):
        settings = json.loads(contents)
        change(settings)
        return json.dumps(settings).encode()

    return rebuilt(model(name), {"data": changed})


def with_state(changes, name="ppo"):
    """A model whose policy.pth has other members; names without their folder."""
    inner = {f"archive/{member}": contents for member, contents in changes.items()}
    return rebuilt(model(name), {"policy.pth": lambda contents: rebuilt(contents, inner)})


class Payload:
    """Unpickling one creates a file."""

    def __init__(self, trace):
        self._trace = str(trace)

    def __reduce__(self):
        return (open, (self._trace, "w"))


def payload(trace, protocol=2):
    """A pickle that creates the file `trace` when it is run."""
    return pickle.dumps(Payload(trace), protocol)
