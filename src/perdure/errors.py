"""Errors and warnings of perdure, the sentence that offers the nearest name, and the call that a hang is blamed on."""

from __future__ import annotations

import difflib
import itertools
import mmap
import sys
import traceback
import warnings
from collections.abc import Iterable, Mapping, Sequence
from typing import TypeVar

_T = TypeVar("_T")
MANUAL = "https://github.com/perdure/perdure/blob/main/docs/how-to/any-policy.md"
"""Page for policies that are not read."""


class PerdureError(ValueError):
    """An argument or a file is wrong: the message names it, says what is wrong and what is allowed."""


class DetailedError(PerdureError):
    """A PerdureError whose lines are shown as they are; those of others are joined to one."""


class UnitBusyError(PerdureError):
    """Another process is running the unit."""


class PerdureWarning(UserWarning):
    """Something is unusual and perhaps wrong."""


class OtherSourceWarning(PerdureWarning):
    """Finished units were made by another version of perdure's source code and are reused."""


def warn(text: str, category: type[PerdureWarning] = PerdureWarning) -> None:
    """Warn at the line of the caller's code that called perdure, so that no line of perdure's is shown."""
    outside = 2
    for level, (frame, _) in enumerate(traceback.walk_stack(sys._getframe(1)), 2):
        if str(frame.f_globals.get("__name__", "")).partition(".")[0] == "perdure":
            outside = level + 1
    warnings.warn(category(text), stacklevel=outside)


def lookup(table: Mapping[str, _T], name: str, what: str) -> _T:
    """Return the entry of a table; an unknown name raises PerdureError, which says what there is and what is near."""
    if name not in table:
        raise PerdureError(f"no {what} is named {name!r}; there are {', '.join(table)}{did_you_mean(name, table)}")
    return table[name]


def did_you_mean(name: object, names: Iterable[str], most: int = 1, first: Sequence[str] = ()) -> str:
    """Return "; did you mean 'a' or 'b'?" with the names nearest to a wrong one, "" if none is near.

    Args:
        name: What was asked for; case is ignored.
        names: What there is.
        most: Names to offer.
        first: Names to offer before these, however they are spelled.
    """
    folded = {each.casefold(): each for each in names}
    near = difflib.get_close_matches(str(name)[:80].casefold(), folded, n=most, cutoff=0.65)
    offered = [*first, *(folded[each] for each in near)]
    if not offered:
        return ""
    return f"; did you mean {' or '.join(map(repr, offered))}?"


PAGE_BYTES = 512
"""Of a page: the words of one call, cut to a quarter."""
call_pages = [mmap.mmap(-1, PAGE_BYTES)]
"""What third-party code this process and its workers are calling, readable when it hangs or has ended the process."""
_numbers = itertools.count()


def note_call(words: str) -> None:
    """Write into this process's page what is called from now on; "" for nothing."""
    text = ""
    if words:
        text = f"{next(_numbers)} {words}"[: PAGE_BYTES // 4]
    call_pages[0].seek(0)
    call_pages[0].write(text.encode() + b"\0")


def noted_call(page: mmap.mmap) -> str:
    """Return the number and the words of the call that a page names; "" between calls."""
    return page[:].partition(b"\0")[0].decode(errors="replace")
