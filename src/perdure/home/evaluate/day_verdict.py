"""Verdicts on days without a reset, from their table alone: what became of each home, and how often a person must help.

An *intervention* is one of `INTERVENTIONS`. After it nothing is put back: the home goes on as it is, so that one object
on the floor counts once, and a home may need several.

A home is *worse* than at its start if an object lies on the floor, is tipped or is out of reach. At its start none is.

A home's verdict is the first of `home_outcomes()` that applies:

"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from perdure.home.evaluate.day_table import DIVERGED, HARM, HOME, NO_ERRAND_LEFT
from perdure.report.outcomes import CannotTell, Decays, Diverges, FailsSilently, Holds, NeverWorked, Outcome
from perdure.stats import BoolArray, FailureRate, FloatArray, fewer_p

if TYPE_CHECKING:
    import polars as pl

STUCK_SECONDS = 30.0
"""A robot that stood so long at one place without a success no longer moves (our choice: four skills fail in it)."""
FEWEST_ERRANDS = 4
"""Errands that a verdict needs, but that of a home whose day ended early."""
WORKS_FROM = 0.5
"""Share of the first half of its errands that must stay for a robot to work at all (our choice)."""
CHANCE = 0.05
"""A smaller p value is no chance."""
INTERVENTIONS: Mapping[str, str] = {
    "taken over": "the oracle took over a skill",
    "on the floor": "an object fell on the floor",
    "tipped target": "a target is tipped at the end of its errand",
    "stuck": f"the robot stood at one place for {STUCK_SECONDS:g} s and no skill succeeded",
    "stopped": "no errand could be drawn any more, or the simulation diverged",
}
"""Kind to what happened."""


@dataclass(frozen=True)
class HomeFacts:
    """What is known of the day of a home, up to some hour."""

    stays: BoolArray
    """Which errands stay, in order. Shape (errands,)."""
    interventions: int
    harm: int
    """Objects on the floor, tipped or out of reach at the end."""
    then: str
    """What came after its last errand, one of `day_table.ENDINGS`."""

    @property
    def first_half(self) -> BoolArray:
        """Which errands of the first half stay."""
        return self.stays[: len(self.stays) // 2]

    @property
    def second_half(self) -> BoolArray:
        """Which errands of the second half stay; of an odd number it has the middle one."""
        return self.stays[len(self.stays) // 2 :]

    @property
    def decayed(self) -> bool:
        """Whether fewer errands of the second half stay than of the first, by more than chance."""
        first = self.first_half
        second = self.second_half
        return fewer_p(int(second.sum()), len(second), int(first.sum()), len(first)) < CHANCE


class HomeOutcome(Outcome):
    """What became of a home in its day: a vocabulary; `order` is that in which the rules are tried."""

    def applies(self, home: HomeFacts) -> bool:
        """Return whether a home has this outcome, if none has that is tried before."""
        return False


@dataclass(frozen=True)
class HomeDiverges(HomeOutcome):
    """The simulation broke."""

    name = Diverges.name
    good = False
    order = 1
    meaning = "the simulation becomes invalid"

    def applies(self, home: HomeFacts) -> bool:
        """See `meaning`."""
        return home.then == DIVERGED


@dataclass(frozen=True)
class NoErrandLeft(HomeOutcome):
    """The robot has nothing to do any more."""

    name = NO_ERRAND_LEFT
    good = False
    order = 2
    meaning = "no errand can be drawn for the objects where they are now"

    def applies(self, home: HomeFacts) -> bool:
        """See `meaning`."""
        return home.then == NO_ERRAND_LEFT


@dataclass(frozen=True)
class TooShort(HomeOutcome):
    """There is no verdict yet."""

    name = CannotTell.name
    order = 3
    meaning = f"it has fewer than {FEWEST_ERRANDS} errands"

    def applies(self, home: HomeFacts) -> bool:
        """See `meaning`."""
        return len(home.stays) < FEWEST_ERRANDS


@dataclass(frozen=True)
class NeverDidErrands(HomeOutcome):
    """The robot never did its errands."""

    name = NeverWorked.name
    good = False
    order = 4
    meaning = f"less than {100 * WORKS_FROM:g} % of the first half of its errands stay"

    def applies(self, home: HomeFacts) -> bool:
        """See `meaning`."""
        return float(home.first_half.mean()) < WORKS_FROM


@dataclass(frozen=True)
class DoesFewerErrands(HomeOutcome):
    """Errands fail that succeeded at first."""

    name = Decays.name
    good = False
    order = 5
    meaning = (
        "fewer errands stay in the second half of its day than in the first, by more than chance explains (Fisher's "
        f"exact test, one-sided, {100 * CHANCE:g} %)"
    )

    def applies(self, home: HomeFacts) -> bool:
        """See `meaning`."""
        return home.decayed


@dataclass(frozen=True)
class GetsWorseUnseen(HomeOutcome):
    """The benchmark's count sees nothing, and the home gets worse."""

    name = FailsSilently.name
    good = False
    order = 6
    meaning = "errands stay as in the first half, but the home is worse at the end: what is counted does not notice"

    def applies(self, home: HomeFacts) -> bool:
        """See `meaning`."""
        return home.harm > 0


@dataclass(frozen=True)
class NeedsHelp(HomeOutcome):
    """The home is in order, with the help of the oracle or of a person."""

    name = "needs help"
    good = False
    order = 7
    meaning = "the home is as at its start, but somebody had to intervene"

    def applies(self, home: HomeFacts) -> bool:
        """See `meaning`."""
        return home.interventions > 0


@dataclass(frozen=True)
class HomeHolds(HomeOutcome):
    """The robot does at the end of the day what it did at first, and the home is in order."""

    name = Holds.name
    good = True
    order = 8
    meaning = "errands stay as in the first half, nobody had to intervene, and the home is as at its start"

    def applies(self, home: HomeFacts) -> bool:
        """Return True: it is tried last."""
        return True


def home_outcomes() -> list[HomeOutcome]:
    """Return all outcomes in the order in which their rules are tried."""
    return sorted((kind() for kind in HomeOutcome.kinds().values()), key=lambda each: (each.order, each.name))


_OWN: tuple[type[HomeOutcome], ...] = tuple(sorted(HomeOutcome.__subclasses__(), key=lambda kind: kind.order))
__doc__ = (__doc__ or "") + "\n".join(
    ["| outcome | a home has it if |", "|---|---|", *(f"| {kind.name} | {kind.meaning} |" for kind in _OWN)]
)


def judge_home(facts: HomeFacts) -> HomeOutcome:
    """Return the outcome of a home."""
    return next(each for each in home_outcomes() if each.applies(facts))


def interventions(days: pl.DataFrame) -> pl.DataFrame:
    """Return how many interventions of each kind every errand brought: a column for each of `INTERVENTIONS`."""
    import polars as pl

    return days.select(
        pl.col("taken_over").alias("taken over"),
        pl.col("fell").alias("on the floor"),
        pl.col("tipped_targets").alias("tipped target"),
        (pl.col("stood") >= STUCK_SECONDS).cast(pl.Int64).alias("stuck"),
        pl.col("then").is_in([NO_ERRAND_LEFT, DIVERGED]).cast(pl.Int64).alias("stopped"),
    )


def judge_days(days: pl.DataFrame, until: float = math.inf) -> pl.DataFrame:
    """Return one row for each home, ordered by `day_table.HOME`.

    Columns: those of `HOME`; `verdict`; `errands_done`; `hours` watched; `interventions` in all; `first_intervention`,
    when the errand ended that brought the first one [h], inf without one; `HARM` at the end.

    Args:
        days: A table of days.
        until: Only errands that ended by this hour count.
    """
    import polars as pl

    counted = days.with_columns(helped=interventions(days).sum_horizontal()).filter(pl.col("end") <= until)
    rows = []
    for key, home in counted.sort(*HOME, "errand").group_by(HOME, maintain_order=True):
        last = home.row(-1, named=True)
        helped = home.filter(pl.col("helped") > 0)["end"]
        facts = HomeFacts(
            stays=home["stays"].to_numpy(),
            interventions=int(home["helped"].sum()),
            harm=sum(last[name] for name in HARM),
            then=last["then"],
        )
        rows.append(
            {
                **dict(zip(HOME, key, strict=True)),
                "verdict": judge_home(facts).name,
                "errands_done": home.height,
                "hours": last["end"],
                "interventions": facts.interventions,
                "first_intervention": helped[0] if len(helped) else math.inf,
                **{name: last[name] for name in HARM},
            }
        )
    return pl.DataFrame(rows)


def failure_times(homes: pl.DataFrame) -> tuple[FloatArray, BoolArray]:
    """Return until when each home of `judge_days` was watched without an intervention [h], and whether one ended that.

    Shapes (homes,), for `perdure.stats.kaplan_meier`.
    """
    first = homes["first_intervention"].to_numpy()
    return np.minimum(first, homes["hours"].to_numpy()), np.isfinite(first)


def intervention_rate(days: pl.DataFrame, kind: str | None = None) -> FailureRate:
    """Return interventions per hour with exact bounds, of one kind or of all; every home is watched to its end.

    The bounds hold for interventions that come independently at a constant rate; `FailureRate.constant_p` tests the
    latter.
    """
    import polars as pl

    kinds = interventions(days)
    events = kinds.sum_horizontal() if kind is None else kinds[kind]
    times = np.repeat(days["end"].to_numpy(), events.to_numpy())
    ends = days.group_by(HOME).agg(pl.col("end").max())["end"].to_numpy()
    watched = np.minimum(times[:, None], ends[None, :]).sum(axis=1)  # hours of all homes until each one
    total = float(ends.sum())
    return FailureRate(len(times), total, int((watched <= 0.5 * total).sum()))
