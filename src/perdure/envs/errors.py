"""Errors of worlds."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

SUGGESTIONS = 3


class WorldError(ValueError):
    """A world was built, reset or stepped with something it cannot accept; the message names it and what is valid."""


class UnknownTask(WorldError):  # noqa: N818 - reads as the sentence it prints
    """No suite knows a task under this name; the message offers the nearest names that exist."""

    def __init__(self, task: str, known: Iterable[str], meant: tuple[str, ...] = ()) -> None:
        """Build the message.

        Args:
            task: The name that was asked for.
            known: Every name that would have been accepted.
            meant: Names to offer first, however they are spelled.
        """
        self.task = task
        self.nearest = meant + nearest_names(task, known)
        hint = f"Did you mean {' or '.join(self.nearest)}? " if self.nearest else ""
        super().__init__(
            f"There is no task named {task!r}. {hint}`perdure list` shows every task; "
            "any Gymnasium environment works as gymnasium:<id>, "
            "and one that your own module registers as gymnasium:<module>:<id>."
        )


def nearest_names(name: str, known: Iterable[str]) -> tuple[str, ...]:
    """Return the names nearest to `name`, best first; case is ignored.

    Args:
        name: What was asked for.
        known: The names to choose from.

    Returns:
        At most `SUGGESTIONS` names; empty when nothing is similar.
    """
    by_folded = {candidate.casefold(): candidate for candidate in known}
    close = difflib.get_close_matches(str(name).casefold(), by_folded, n=SUGGESTIONS, cutoff=0.7)
    return tuple(by_folded[folded] for folded in close)
