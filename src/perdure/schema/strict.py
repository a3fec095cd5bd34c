"""JSON of unknown origin."""

from __future__ import annotations

import json
from typing import Any

from perdure.schema.errors import SchemaError


def read_json(text: str | bytes) -> Any:
    """Return the value that JSON text describes.

    Infinity and NaN are read, as Python writes them; a schema says where they are allowed.

    Raises:
        SchemaError: The text is no JSON, is nested too deep, or holds a number of too many digits.
    """
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:  # a UnicodeDecodeError and a JSONDecodeError are ValueErrors
        reason = "it is nested too deep" if isinstance(error, RecursionError) else str(error)
        raise SchemaError(f"it is not readable JSON: {reason}") from None
