"""Caveats: why a policy that holds is not clean. Its verdict is then *holds, but*.

A caveat is a class that registers itself (see `perdure.registry`), with a name that completes "holds, but ...", a
sentence and a rule. Verdict lines, page and JSON read this file, so a new caveat is one class here or in another
package. Caveats never change an outcome: a policy with caveats still holds.

"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from perdure.registry import Registered
from perdure.report import wording
from perdure.report.groups import Group, medians
from perdure.stats import FloatArray, Interval

CROOKED_FROM = 10.0
"""Degrees a minute that a robot that walks straight may turn from its commanded heading."""
DRIFTS_FROM = 5.0
"""Meters a minute that it may be off its commanded path: what a turn by `CROOKED_FROM` makes at 1 m/s."""
CALM_WORK = 0.75
"""Least work, as a share of the policy's own when calm."""
INTERRUPTED = 0.05
"""Share of windows that may score too low to hold, beyond that share in training and when calm."""
FEWEST_DISTURBED = 6
"""Disturbed episodes: if all of so many hold, the 95 % interval of the share that holds lies above one half."""
HALF = 0.5
"""Bound of the lower end of that interval."""
IDLE_FALLS = 0.5
"""An idle robot falls at once if its episodes last less than this share of the training horizon."""


@dataclass(frozen=True)
class Held:
    """What is known of a group of episodes that holds or reaches its goal."""

    group: Group
    share: Interval
    """Share of the episodes that hold, with its 95 % interval."""
    work: Interval
    """Mean work against the policy's own calm rate, with its 95 % interval."""
    disturbed: int
    """Disturbed episodes of the same policy and clock."""
    calm: Group | None = None
    """Calm episodes of the same policy and clock; None: there are none."""

    @property
    def usual_low_share(self) -> float:
        """Mean share of windows that score too low in training, or in calm episodes if that is more; nan: unknown."""
        training = _known_mean(self.group["training_low_share"])
        if self.calm is None or self.group.calm:
            return training
        return float(np.fmax(training, _known_mean(self.calm["low_share"])))


def _known_mean(values: FloatArray) -> float:
    """Return the mean of the values that are known; nan where none is."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else math.nan


class Caveat(Registered):
    """Why a policy that holds is not clean."""

    order: ClassVar[int] = 0
    """Place in lists."""
    meaning: ClassVar[str] = ""
    """When it applies, in one sentence that begins in lower case and has no period."""

    def reason(self, held: Held) -> str:
        """Return the evidence, such as "turns 45 degrees a minute"; "" if the caveat does not apply."""
        raise NotImplementedError


class WalksCrooked(Caveat):
    """The robot leaves its commanded path."""

    name = "does not walk straight"
    order = 1
    meaning = (
        f"in the median of the episodes the robot turns more than {CROOKED_FROM:g} degrees a minute from its commanded "
        f"heading, or is off its commanded path by more than {DRIFTS_FROM:g} m a minute"
    )

    def reason(self, held: Held) -> str:
        """Return how far it turns and drifts."""
        found = medians(held.group)
        turn = found.get("heading_error", 0.0)
        drift = found.get("lateral_drift", 0.0)
        parts = []
        if turn > CROOKED_FROM:
            limit = f"(bound {CROOKED_FROM:g}; see heading_control_stiffness)"
            parts.append(f"turns {wording.quantity(turn)} degrees a minute {limit}")
        if drift > DRIFTS_FROM:
            parts.append(f"drifts {wording.quantity(drift)} m a minute (bound {DRIFTS_FROM:g})")
        return " and ".join(parts)


class WorksLess(Caveat):
    """It does clearly less than when calm."""

    name = "works less than when calm"
    order = 2
    meaning = (
        "disturbed, its mean work against its own calm rate, or the lower end of the 95 % interval of this mean, is "
        f"below {CALM_WORK:g}"
    )

    def reason(self, held: Held) -> str:
        """Return its work."""
        mean = float(held.work.estimate)
        low = float(held.work.lower)
        high = float(held.work.upper)
        known = np.isfinite(low)
        least = low if known else mean
        if held.group.calm or not least < CALM_WORK:
            return ""
        interval = f", 95 % interval {low:.2f} to {high:.2f}" if known and low < high else ""
        return f"does {mean:.2f} of its calm work{interval} (bound {CALM_WORK:g})"


class Interrupted(Caveat):
    """It loses what it does, and gets it back."""

    name = "is interrupted"
    order = 3
    meaning = (
        "the share of windows after settling that score too low to hold is larger than in training, and than in calm "
        f"episodes, by more than {INTERRUPTED:g}"
    )

    def reason(self, held: Held) -> str:
        """Return for how much of the time it scores too low."""
        share = _known_mean(held.group["low_share"])
        usual = held.usual_low_share
        if not share - usual > INTERRUPTED:
            return ""
        return f"scores too low {wording.share(share)} of the time (usually {wording.share(usual)})"


class FewDisturbed(Caveat):
    """Too few disturbed episodes to trust the share that holds."""

    name = "met few disturbances"
    order = 4
    meaning = (
        f"fewer than {FEWEST_DISTURBED} episodes of the policy and clock were disturbed, or the 95 % interval of the "
        "share that holds reaches down to one half"
    )

    def reason(self, held: Held) -> str:
        """Return how many there were."""
        if held.disturbed == 0:
            return f"none of its episodes was disturbed (bound {FEWEST_DISTURBED})"
        if held.disturbed < FEWEST_DISTURBED:
            return f"only {held.disturbed} of its episodes were disturbed (bound {FEWEST_DISTURBED})"
        low = float(held.share.lower)
        if not held.group.calm and low <= HALF:
            return f"as few as {wording.share(low)} of its episodes may hold"
        return ""


class IdleEarnsAsMuch(Caveat):
    """Doing nothing would hold, too."""

    name = "earns no more than an idle robot"
    order = 5
    meaning = (
        "an idle robot earns as much a step, and lasts at least half of the training horizon, so that survival alone "
        "was judged"
    )

    def reason(self, held: Held) -> str:
        """Return the rate of both."""
        group = held.group
        lasts = group["idle_steps"]
        falls_at_once = lasts < IDLE_FALLS * group["train_horizon"]  # False where it is unknown
        if (group["training_rate"] != group["idle_rate"]).any() or falls_at_once.all():
            return ""
        return f"an idle robot earns as much ({wording.quantity(float(group['idle_rate'][0]))} a step)"


class OtherEngine(Caveat):
    """It was not trained in what it is judged in."""

    name = "was trained in another simulator"
    order = 6
    meaning = (
        "it was trained in another version of MuJoCo or without MuJoCo, as far as its file says; EnvPool or Gymnasium "
        "makes no difference (their tasks are equal to 1e-9, Humanoid to 1e-7)"
    )

    def reason(self, held: Held) -> str:
        """Return both engines."""
        return next(filter(None, held.group["other_engine"]), "")


def caveats() -> list[Caveat]:
    """Return all caveats in their order."""
    return sorted((kind() for kind in Caveat.kinds().values()), key=lambda each: (each.order, each.name))


def find_caveats(held: Held) -> dict[str, str]:
    """Return the reasons against a clean verdict by the name of their caveat."""
    found = {each.name: each.reason(held) for each in caveats()}
    return {name: reason for name, reason in found.items() if reason}


def listed(names: Sequence[str]) -> str:
    """Return the end of a sentence: ", but works less than when calm and is interrupted"; "" without names."""
    unique = list(dict.fromkeys(names))
    if not unique:
        return ""
    *first, last = unique
    return f", but {', '.join(first)} and {last}" if first else f", but {last}"


_OWN = sorted((kind for kind in Caveat.__subclasses__()), key=lambda kind: kind.order)
__doc__ = "\n".join(
    [
        f"{__doc__ or ''}| holds, but ... | it applies if |",
        "|---|---|",
        *(f"| {kind.name} | {kind.meaning} |" for kind in _OWN),
    ]
)
