"""What `--place` means: a release strategy, or a place policy that was trained to make objects stay."""

from __future__ import annotations

import re
from dataclasses import dataclass

from perdure.home.agents.release import STRATEGIES
from perdure.home.errors import HomeError
from perdure.home.skills import get_skill


@dataclass(frozen=True)
class ReleaseChoice:
    """How objects are released; made by `read_release`."""

    name: str
    """The text it was read from, such as `ik` or `delta-50-in-200`."""
    strategy: str
    """The release strategy, a key of `STRATEGIES`."""
    delta: int = 1
    """For how many steps a placed object must stay before place stops; 1 is the benchmark's rule."""
    limited_to: int | None = None
    """Control steps that place may last; 200 + delta (200 for delta = 1) when None."""

    @property
    def options(self) -> dict[str, int]:
        """Options of `Place` and its environment that differ from the benchmark's."""
        wanted = {"delta": self.delta if self.delta > 1 else None, "limited_to": self.limited_to}
        return {name: value for name, value in wanted.items() if value is not None}

    @property
    def policy(self) -> str:
        """Name of the policy it needs: `place`, or the skill and the variant, such as `place-delta-50`."""
        return "place" if self.name in STRATEGIES else f"place-{self.name}"


def read_release(text: str) -> ReleaseChoice:
    """Read `rl`, `stop`, `ik`, `ik+`, `delta-N` or `delta-N-in-M`.

    delta-N: the policy alone, trained to make objects stay for N steps, with 200 + N steps for it; delta-N-in-M: with M
    steps (M = 200 is the other reading of the thesis' section 2.1.2).

    Raises:
        HomeError: If it is none of these.
    """
    if text in STRATEGIES:
        return ReleaseChoice(text, text)
    found = re.fullmatch(r"delta-(\w*?)(?:-in-(\w*))?", text)
    if found is None:
        raise HomeError(f"place must be one of {', '.join(STRATEGIES)}, delta-N or delta-N-in-M, not {text!r}")
    delta, steps = found.groups()
    if not _is_number(delta) or int(delta) < 2:
        raise HomeError(f"the N in delta-N must be 2 or more, not {delta!r}")
    if steps is not None and not _is_number(steps):
        raise HomeError(f"the M in delta-N-in-M must be a number of steps, not {steps!r}")
    wanted = ReleaseChoice(text, "rl", int(delta), None if steps is None else int(steps))
    get_skill("place", **wanted.options)  # refuses a limit that is too short
    return wanted


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdecimal()
