"""Run matrix products on one thread: with several, the last bits depend on the number of threads."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

_inside = False


@contextmanager
def one_thread() -> Iterator[None]:
    """Run NumPy's matrix products on one thread for the duration of a block.

    Entering the block costs tens of microseconds, so put whole loops inside it.
    """
    global _inside
    if _inside:
        yield
        return
    changed = [(library, number) for library in _libraries() if (number := library.get_num_threads()) != 1]
    for library, _ in changed:
        library.set_num_threads(1)
    _inside = True
    try:
        yield
    finally:
        _inside = False
        for library, number in changed:
            library.set_num_threads(number)


@cache
def _libraries() -> list[Any]:
    """Return the matrix libraries of this process; searched once, because the search takes milliseconds."""
    from threadpoolctl import ThreadpoolController

    controllers: list[Any] = ThreadpoolController().select(user_api="blas").lib_controllers
    return controllers
