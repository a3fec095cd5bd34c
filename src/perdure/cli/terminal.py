"""Print text that fits the width and encoding of any terminal."""

from __future__ import annotations

import codecs
import os
import shlex
import shutil
import sys
from contextlib import suppress

NARROWEST, WIDEST = 40, 1000
"""Columns. Where help has no room for a word, the library that draws it never ends; lines are padded to the width."""
_PLAIN = {"\u2212": "-", "\u2013": "-", "\u2014": "-", "\u00b1": "+-", "\u221e": "inf", "\u201c": '"', "\u201d": '"'}


def prepare_terminal() -> None:
    """Bound the width that libraries see, and write characters that the encoding lacks as plain ones."""
    columns = shutil.get_terminal_size().columns
    if not NARROWEST <= columns <= WIDEST:
        os.environ["COLUMNS"] = str(min(max(columns, NARROWEST), WIDEST))
    codecs.register_error("perdure.plain", _plain)
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError):  # not a text stream of Python's own, as under a test
            stream.reconfigure(errors="perdure.plain")  # type: ignore[union-attr]


def command_line(*words: str) -> str:
    """Return a command as text that every file can hold: bytes that are no UTF-8 are written as numbers."""
    return os.fsencode(shlex.join(words)).decode("utf-8", "backslashreplace")


def _plain(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    found = error.object[error.start : error.end]
    return "".join(_PLAIN.get(each) or _escaped(each) for each in found), error.end


def _escaped(character: str) -> str:
    # Python holds a byte that is no text as a surrogate (PEP 383): shown as the byte it is.
    byte = ord(character) - 0xDC00
    return f"\\x{byte:02x}" if 0x80 <= byte <= 0xFF else ascii(character)[1:-1]
