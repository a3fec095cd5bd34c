"""``perdure`` and ``python -m perdure``: the command line, and how its failures look."""

from __future__ import annotations

import os
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from perdure.errors import DetailedError, PerdureError, PerdureWarning
from perdure.schema import printable

AGAIN_SECONDS = 0.05
"""Until an interruption that Python dropped is raised again."""


def main(args: Sequence[str] | None = None) -> None:
    """Run the command line.

    What a user can cause ends in one line and exit code 2, Ctrl-C in 130 and SIGTERM in 143, with all workers ended.

    Args:
        args: The arguments of the program; by default those of this process.
    """
    if args is None:
        args = sys.argv[1:]
    words = list(args)
    from perdure.cli import prepare_terminal, resumes, run

    prepare_terminal()
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) != signal.SIG_IGN:  # nohup and shells ignore SIGINT for commands in the background
            signal.signal(number, _stop)
    sys.unraisablehook = partial(_raise_again, sys.unraisablehook)
    warnings.showwarning = partial(_show_warning, warnings.showwarning)
    try:
        run(words)
    except BrokenPipeError:
        sys.stderr.close()  # the reader of the pipe is gone, so nothing can be printed
    except KeyboardInterrupt as interrupt:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the end is not to be interrupted
        then = "the same command starts from the beginning"
        if resumes(words):
            then = "run the same command to continue"
        notes = getattr(interrupt, "__notes__", [])
        if notes:  # the command knows what is kept
            then = notes[-1]
        print(f"perdure: interrupted; {then}", file=sys.stderr)
        if isinstance(interrupt, _TerminatedError):
            sys.exit(143)
        sys.exit(130)
    except (PerdureError, OSError) as error:
        print(f"perdure: {_sentence(error)}", file=sys.stderr)
        sys.exit(2)


class _TerminatedError(KeyboardInterrupt):
    """SIGTERM."""


def _stop(number: int, frame: object) -> None:
    if number == signal.SIGTERM:
        raise _TerminatedError
    raise KeyboardInterrupt


def _raise_again(others: Callable[..., None], dropped: Any) -> None:
    """Raise an interruption that Python dropped, because it came in a callback, as at the end of an import."""
    kind = dropped.exc_type
    if not issubclass(kind, KeyboardInterrupt):
        others(dropped)
        return
    number = signal.SIGINT
    if issubclass(kind, _TerminatedError):
        number = signal.SIGTERM
    signal.signal(signal.SIGALRM, lambda alarm, frame: _stop(number, frame))
    signal.setitimer(signal.ITIMER_REAL, AGAIN_SECONDS)


def _show_warning(others: Callable[..., None], message: Warning | str, category: type[Warning], *where: Any) -> None:
    """Print perdure's own warnings as one line; leave other warnings unchanged."""
    if issubclass(category, PerdureWarning):
        print(f"perdure: {printable(str(message))}", file=sys.stderr)
    else:
        others(message, category, *where)


def _sentence(error: ValueError | OSError) -> str:
    text = " ".join(str(error).split())
    if isinstance(error, DetailedError):
        text = str(error)
    if isinstance(error, OSError) and error.strerror:
        text = error.strerror
        if error.filename:
            text = f"{error.filename}: {text}"
    return printable(os.fsencode(text).decode("utf-8", "backslashreplace"), isinstance(error, DetailedError))


if __name__ == "__main__":
    main()
