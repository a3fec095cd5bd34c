"""Matrix products on one thread: on several, a library adds up in another order, and the last bits tell how many."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

_inside = False


@contextmanager
def one_thread() -> Iterator[None]:
    """While it lasts, NumPy's matrix products run on one thread, whatever the process is set to.

    Asking the libraries takes tens of microseconds: a loop that stays inside pays for it once.
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
    """What multiplies matrices in this process; found once, for looking takes milliseconds."""
    from threadpoolctl import ThreadpoolController

    controllers: list[Any] = ThreadpoolController().select(user_api="blas").lib_controllers
    return controllers
