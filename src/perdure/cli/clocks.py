"""Read the clock of a flag, in the same way for every command that has one policy."""

from __future__ import annotations

from typing import TYPE_CHECKING

from perdure.errors import PerdureError

if TYPE_CHECKING:
    from perdure.horizon import Clock
    from perdure.policy import Policy


def read_clock(flag: str, text: str | None, policy: Policy, steps: int | None = None) -> Clock | None:
    """Return the clock that a flag names; None if the flag is left out.

    Args:
        flag: Name of the flag, for the message.
        text: "default" (the policy's own clock), "countdown" (to the end), or as `perdure.horizon.parse_clock` reads.
        policy: The policy that gets the clock.
        steps: Steps of the episode; None if the command knows no end, so that a countdown must name its steps.

    Raises:
        PerdureError: If the text is "default" and the policy has no time-to-go input.
        PerdureError: If the text names no clock.
    """
    from perdure.horizon import Countdown, parse_clock

    if text is None:
        return None
    if text == "default":
        if policy.clock is None:
            raise PerdureError(
                f"{flag} default: this {policy.task.name} policy has no time-to-go input, so it takes no clock"
            )
        return policy.clock
    return Countdown(float(steps)) if text == "countdown" and steps is not None else parse_clock(text)
