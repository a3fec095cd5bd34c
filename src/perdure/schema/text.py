"""Text of unknown origin, made safe to show."""

from __future__ import annotations

import re

_UNSEEN = (
    "\x00-\x1f\x7f-\x9f"  # control characters, with them the escape that begins a terminal's commands
    "\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069"  # marks that turn the direction of what follows
    "\u2028\u2029"  # separators that some programs take for line ends
    "\ud800-\udfff"  # surrogates: no text, and no encoding can write them
)
UNSEEN = re.compile(f"[{_UNSEEN}]")
"""Characters that change how other text is shown instead of being shown."""
_UNSEEN_BUT_LINES = re.compile(f"(?![\n\t])[{_UNSEEN}]")


def printable(text: str, lines: bool = False) -> str:
    """Return text without characters that act on a terminal; each becomes the replacement character.

    Args:
        text: Of any origin.
        lines: Keep line ends and tabs.
    """
    return (_UNSEEN_BUT_LINES if lines else UNSEEN).sub("\ufffd", text)
