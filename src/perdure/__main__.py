"""``perdure`` and ``python -m perdure``: the command line, and how its failures look."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any


def main() -> None:
    """Runs the command line. What a user can cause ends in one line and exit code 2, an interrupt in 130."""
    from perdure.cli import run

    warnings.showwarning = partial(_show_warning, warnings.showwarning)
    try:
        run(sys.argv[1:])
    except BrokenPipeError:
        sys.stderr.close()  # the reader of a pipe has left; there is nobody to tell
    except KeyboardInterrupt:
        sys.exit(130)
    except (ValueError, OSError) as error:
        if not _is_users(error):
            raise
        print(f"perdure: {_sentence(error)}", file=sys.stderr)
        sys.exit(2)


def _show_warning(others: Callable[..., None], message: Warning | str, category: type[Warning], *where: Any) -> None:
    """Ours are one line for a user; where in the code they were raised is for everybody else's."""
    if category.__module__.startswith("perdure."):
        print(f"perdure: {message}", file=sys.stderr)
    else:
        others(message, category, *where)


def _is_users(error: ValueError | OSError) -> bool:
    """Ours are subclasses of ValueError from this package; a plain ValueError is a fault of the program."""
    return isinstance(error, OSError) or type(error).__module__.startswith("perdure.")


def _sentence(error: ValueError | OSError) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return " ".join(str(error).split())


if __name__ == "__main__":
    main()
