"""``perdure`` and ``python -m perdure``: the command line, and how its failures look."""

from __future__ import annotations

import sys


def main() -> None:
    """Runs the command line. What a user can cause ends in one line and exit code 2, an interrupt in 130."""
    from perdure.cli import run

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


def _is_users(error: ValueError | OSError) -> bool:
    """Ours are subclasses of ValueError from this package; a plain ValueError is a fault of the program."""
    return isinstance(error, OSError) or type(error).__module__.startswith("perdure.")


def _sentence(error: ValueError | OSError) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return " ".join(str(error).split())


if __name__ == "__main__":
    main()
