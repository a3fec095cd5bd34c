"""Type checks of options, which may come as text: a word such as "no" must not count as True."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from perdure.home.errors import HomeError
from perdure.schema import Flag, Kind, SchemaError


class PythonFlag(Flag):
    """True or False, spelled as in Python in the message."""

    allowed = "True or False"


def plain(value: Any) -> Any:
    """Return a NumPy number or array as Python numbers; any other value itself."""
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else value


def check_kinds(kinds: Mapping[str, Kind], values: Mapping[str, object]) -> None:
    """Raise HomeError, with name, value and what is allowed, for a value that is not of its kind."""
    try:
        for name, kind in kinds.items():
            kind.check(plain(values[name]), name)
    except SchemaError as error:
        raise HomeError(str(error)) from None


def checked_mode(value: AutoresetMode | str) -> AutoresetMode:
    """Return an autoreset mode by its name; HomeError for any other value."""
    try:
        return AutoresetMode(value)
    except ValueError:
        names = ", ".join(repr(mode.value) for mode in AutoresetMode)
        raise HomeError(f"autoreset_mode must be one of {names}, not {value!r}") from None
