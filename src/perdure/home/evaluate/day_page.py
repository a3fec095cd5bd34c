"""The page of days without a reset: verdicts by hour, how homes decay over errands, hours between interventions.

Everything here is a function of a table of days.
"""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from perdure.home.evaluate.comparison import describe
from perdure.home.evaluate.counts import COUNTS
from perdure.home.evaluate.day_table import COUNTED, GROUP, HARM, HOME, TIME_IS_UP
from perdure.home.evaluate.day_verdict import (
    INTERVENTIONS,
    failure_times,
    home_outcomes,
    intervention_rate,
    interventions,
    judge_days,
)
from perdure.home.evaluate.strategy import Strategy
from perdure.report import charts, wording
from perdure.report import page as document
from perdure.report.charts import Axis, Curve, Figure, Format, curve_chart, save, slug, unique
from perdure.report.lead import Chip, VerdictRow
from perdure.runs import write_atomic
from perdure.stats import (
    TRAINING_SEEDS,
    FailureRate,
    FloatArray,
    Interval,
    kaplan_meier,
    mean_interval,
    survival_interval,
)

if TYPE_CHECKING:
    import polars as pl

PAGE = "report.html"
SEED = 0
"""Of the bootstrap."""
MOST_HOURS = 12
"""Most rows of the table of verdicts by hour."""
SHOWN_ERRANDS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
"""Errands whose homes a table shows."""
WORDS = {
    "on_floor": "on the floor",
    "tipped": "tipped",
    "out_of_reach": "out of reach",
    "doors_open": "doors and drawers open",
    "knocked_over": "knocked over so far",
}
"""Column to what a reader sees."""
METHOD = """A home is one apartment with its objects. It is never reset: every errand begins as the one before it ended,
with new goals for objects where they are. After an intervention nothing is put back, so the home goes on decaying.
<em>All four</em>: the targets stay, stand upright, nothing else was disturbed, and contact forces stayed low. Every
number comes from the table of errands alone."""


@dataclass(frozen=True)
class DayView:
    """The days of homes with the same errands, split and strategy."""

    name: str
    days: pl.DataFrame

    @cached_property
    def homes(self) -> pl.DataFrame:
        """Their verdicts, see `judge_days`."""
        return judge_days(self.days)

    @property
    def runs(self) -> list[int]:
        """The training seed of each home."""
        return self.homes["train_seed"].to_list()

    @property
    def hours(self) -> float:
        """The longest day."""
        return float(self.homes["hours"].max())  # type: ignore[arg-type]

    @cached_property
    def errands(self) -> int:
        """Number of errands that every home did whose day was not ended early."""
        full = self.days.filter(self.days["then"] == TIME_IS_UP)["errand"]
        shown = self.days["errand"].max() if full.is_empty() else full.min()
        return int(shown)  # type: ignore[arg-type]

    def by_errand(self, column: pl.Expr, ended: float | None) -> FloatArray:
        """Return a column of every home, shape (homes, errands).

        After its last errand a home counts as `ended`; None: as it was left.
        """
        found = []
        for _, home in self.days.sort(*HOME, "errand").group_by(HOME, maintain_order=True):
            values = home.select(column.cast(float)).to_series().to_list()[: self.errands]
            last = values[-1] if ended is None else ended
            found.append(values + [last] * (self.errands - len(values)))
        return np.array(found)


def make_views(days: pl.DataFrame) -> list[DayView]:
    """Return the groups of a table of days, ordered by `GROUP`."""
    views = []
    for (errands, split, *strategy), part in sorted(days.group_by(GROUP), key=lambda each: str(each[0])):
        run = Strategy(*map(str, strategy))
        views.append(DayView(f"{', '.join(str(errands).split())} ({split}): {describe(run)}", part))
    return views


def all_four() -> pl.Expr:
    """Return the expression of all four counts."""
    import polars as pl

    return pl.all_horizontal(COUNTED)


# In words


def headline(view: DayView) -> str:
    """Return how many homes hold, and what most others do."""
    counts = Counter(view.homes["verdict"].to_list())
    good = {each.name for each in home_outcomes() if each.good}
    holding = sum(count for word, count in counts.items() if word in good)
    others = [(count, word) for word, count in counts.items() if word not in good]
    text = f"{holding} of {view.homes.height:,} homes hold for {wording.duration(view.hours)}"
    if others:
        count, word = max(others)
        text += f"; the most common other verdict is {word} ({count})"
    return text


def rate_text(rate: FailureRate) -> str:
    """Return the hours between interventions with their lower bound: "0.5 h [0.3 h or more]"."""
    least = wording.duration(1.0 / rate.upper)
    if not rate.events:
        return f"none in {wording.duration(rate.exposure_hours)} [{least} or more]"
    return f"{wording.duration(rate.mean_hours)} [{least} or more]"


def share_text(interval: Interval) -> str:
    """Return a share with its interval: "83 % [70 % to 92 %]"."""
    text = wording.share(float(interval.estimate))
    if not math.isfinite(float(interval.lower)):
        return text
    return f"{text} [{wording.share(float(interval.lower))} to {wording.share(float(interval.upper))}]"


def summary(view: DayView) -> str:
    """Return the main numbers as text for a terminal."""
    lines = [view.name, f"  {headline(view)}"]
    lines += [f"  {title}: {text}" for title, text in _main_numbers(view)]
    return "\n".join(lines)


def _main_numbers(view: DayView) -> Iterator[tuple[str, str]]:
    yield "errands that stay", share_text(_share(view.days, "stays"))
    yield "all four counts", share_text(_share(view.days, "all_four"))
    yield "time between interventions", rate_text(intervention_rate(view.days))
    last = view.homes.select(HARM).mean().row(0)
    parts = [f"{wording.quantity(value)} {WORDS[name]}" for name, value in zip(HARM, last, strict=True)]
    yield "objects a home at its end", ", ".join(parts)


def _share(days: pl.DataFrame, count: str) -> Interval:
    """Return the share of errands with one of `COUNTS`: homes are averaged first, then training runs."""
    import polars as pl

    column = all_four() if count == "all_four" else pl.col(count)
    homes = days.group_by(HOME, maintain_order=True).agg(share=column.cast(float).mean())
    return mean_interval(homes["share"], homes["train_seed"], np.random.default_rng(SEED)).within(0.0, 1.0)


# Figures


def make_figures(view: DayView) -> list[Figure]:
    """Return the figures of a group of homes."""
    drawn = [decay_figure(view), counts_figure(view), survival_figure(view)]
    return [replace(each, name=slug(each.name, view.name), heading=view.name) for each in drawn]


def _sample(view: DayView) -> str:
    return f"n = {wording.count(view.homes.height, 'home')}"


def _intervals_note(view: DayView, interval: Interval) -> str:
    units = "training seeds" if interval.label == TRAINING_SEEDS else "homes of one training seed"
    if not np.isfinite(interval.lower).any():
        return f"No intervals: too few units, or none differ ({interval.count} {units})."
    return f"Bands: pointwise 95 % intervals over {interval.count} {units} ({interval.method})."


def _means(view: DayView, values: FloatArray) -> Interval:
    return mean_interval(values, view.runs, np.random.default_rng(SEED))


def decay_figure(view: DayView) -> Figure:
    """Return the figure of how a home decays: objects on the floor, tipped and out of reach, over errands."""
    import polars as pl

    x = np.arange(1.0, view.errands + 1.0)
    curves = []
    for place, name in enumerate(HARM):
        found = _means(view, view.by_errand(pl.col(name), ended=None))
        lower = np.maximum(found.lower, 0.0)
        curves.append(Curve(WORDS[name], x, found.estimate, charts.style(place), lower, found.upper))
    return Figure(
        name="decay",
        title="How a home decays",
        chart=curve_chart(
            curves, Axis("errands since the home was in order", low=1.0), Axis(f"objects a home ({_sample(view)})")
        ),
        note="Mean over all homes; one whose day ended early counts as it was left. " + _intervals_note(view, found),
    )


def counts_figure(view: DayView) -> Figure:
    """Return the share of homes whose errand stays, and has all four counts, over errands."""
    import polars as pl

    x = np.arange(1.0, view.errands + 1.0)
    curves = []
    for place, (label, column) in enumerate({"stays": pl.col("stays"), "all four": all_four()}.items()):
        found = survival_interval(view.by_errand(column, ended=0.0), view.runs, np.random.default_rng(SEED))
        curves.append(Curve(label, x, found.estimate, charts.style(place), found.lower, found.upper))
    return Figure(
        name="counts",
        title="Errands that count as done",
        chart=curve_chart(
            curves,
            Axis("errands since the home was in order", low=1.0),
            Axis(f"share of homes ({_sample(view)})", percent=True),
        ),
        note="An errand that could not be drawn any more is not done. " + _intervals_note(view, found),
    )


def survival_figure(view: DayView) -> Figure:
    """Return the share of homes without an intervention so far (Kaplan-Meier), over hours."""
    times, failed = failure_times(view.homes)
    at, share = kaplan_meier(times, failed)
    x = np.array([0.0, *at])
    y = np.array([1.0, *share])
    found = survival_interval(~failed, view.runs, np.random.default_rng(SEED))
    bounds = np.full((2, len(x)), np.nan)
    bounds[:, -1] = float(found.lower), float(found.upper)
    curve = Curve("no intervention", x, y, charts.style(0), bounds[0], bounds[1], named=False, intervals="last")
    return Figure(
        name="survival",
        title="Homes in which nobody had to intervene so far",
        chart=curve_chart(
            [curve],
            Axis("simulated hours", high=view.hours),
            Axis(f"share of homes ({_sample(view)})", percent=True),
            steps=True,
            width=charts.WIDE,
        ),
        note=f"An intervention counts at the end of its errand. Bar at the right: {_interval_words(found)}",
        wide=True,
    )


def _interval_words(interval: Interval) -> str:
    units = "training seeds" if interval.label == TRAINING_SEEDS else "homes of one training seed"
    if not math.isfinite(float(interval.lower)):
        return f"none, too few units or none differ ({interval.count} {units})."
    return f"95 % interval over {interval.count} {units} ({interval.method})."


# Tables


@dataclass(frozen=True)
class PageTable:
    """A table of a page, as text."""

    title: str
    headings: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    note: str = ""


def make_tables(view: DayView) -> list[PageTable]:
    """Return the tables of a group of homes."""
    return [verdict_table(view), counts_table(view), intervention_table(view), state_table(view)]


def verdict_table(view: DayView) -> PageTable:
    """Return verdicts hour by hour: homes of each outcome, and the share that holds."""
    words = [each.name for each in home_outcomes()]
    holding = [each.name for each in home_outcomes() if each.good]
    full_hours = range(1, min(math.floor(view.hours), MOST_HOURS) + 1)
    rows = []
    for until in [*map(float, full_hours), math.inf]:
        homes = judge_days(view.days, until)
        counts = Counter(homes["verdict"].to_list())
        holds = homes["verdict"].is_in(holding).to_numpy()
        share = survival_interval(holds, homes["train_seed"], np.random.default_rng(SEED))
        title = f"{until:g} h" if math.isfinite(until) else "the whole day"
        rows.append((title, *(str(counts[word]) for word in words), share_text(share)))
    meanings = "; ".join(f"{each.name}: {each.meaning}" for each in home_outcomes())
    note = f"Homes with that verdict after so many hours; the first that applies. {meanings}."
    return PageTable("Verdicts by hour", ("after", *words, "hold"), rows, note)


def counts_table(view: DayView) -> PageTable:
    """Return the share of errands with each of the four counts, by task."""
    import polars as pl

    parts = {task: view.days.filter(pl.col("task") == task) for task in sorted(view.days["task"].unique())}
    if len(parts) > 1:
        parts["all"] = view.days
    rows = []
    for task, part in parts.items():
        shares = [share_text(_share(part, name)) for name in COUNTS]
        rows.append((task, f"{part.height:,}", *shares))
    note = "Means over the errands of a home, then homes, with 95 % intervals over training seeds (one: over homes)."
    return PageTable(
        "Errands by the four counts", ("task", "errands", *(name.replace("_", " ") for name in COUNTS)), rows, note
    )


def intervention_table(view: DayView) -> PageTable:
    """Return how often each kind of intervention was needed, and the time between two."""
    kinds = interventions(view.days)
    rows = []
    for kind, what in INTERVENTIONS.items():
        rate = intervention_rate(view.days, kind)
        homes = view.days.filter(kinds[kind] > 0).select(HOME).n_unique()
        rows.append((what, f"{rate.events:,}", f"{rate.per_hour:.2f}", rate_text(rate), str(homes)))
    rate = intervention_rate(view.days)
    rows.append(("any", f"{rate.events:,}", f"{rate.per_hour:.2f}", rate_text(rate), _helped_homes(view)))
    note = (
        f"{wording.duration(rate.exposure_hours)} of {wording.count(view.homes.height, 'home')}. In brackets: exact "
        "lower bound (95 %, chi-square) for interventions that come independently and at a constant rate"
    )
    if rate.events:
        note += f" (p of a constant rate: {rate.constant_p:.2g})"
    headings = ("intervention", "number", "per hour", "time between two", "homes")
    return PageTable("Interventions", headings, rows, f"{note}.")


def _helped_homes(view: DayView) -> str:
    return str(int((view.homes["interventions"] > 0).sum()))


def state_table(view: DayView) -> PageTable:
    """Return the state of homes after some errands."""
    import polars as pl

    rows = []
    values = {name: view.by_errand(pl.col(name), ended=None).mean(axis=0) for name in (*HARM, "doors_open")}
    values["knocked_over"] = view.by_errand(pl.col("knocked_over"), ended=0.0).mean(axis=0).cumsum()
    for errand in [each for each in SHOWN_ERRANDS if each <= view.errands]:
        rows.append((str(errand), *(wording.quantity(float(means[errand - 1])) for means in values.values())))
    headings = ("after errand", *(WORDS[name] for name in values))
    return PageTable("State of a home", headings, rows, f"Means over {wording.count(view.homes.height, 'home')}.")


# The page


def write_page(days: pl.DataFrame, out: str | os.PathLike[str], command: str, formats: Sequence[Format]) -> Path:
    """Write `report.html`, which needs no network, and each figure as a file beside it; return the page.

    Args:
        days: A table of days; several errands and strategies may be in it.
        out: A folder; made if it is missing.
        command: What made the page.
        formats: Of the files: "png", "svg", "pdf"; () writes the page alone.

    Raises:
        PerdureError: An unknown format.
        OSError: The folder cannot be written.
    """
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    parts: list[str] = []
    taken: set[str] = set()
    for view in make_views(days):
        figures = unique(make_figures(view), taken)
        save(figures, folder, formats)
        points = [f"{title[0].upper()}{title[1:]}: {text}." for title, text in _main_numbers(view)]
        parts += [document.header(view.name, headline(view), points, _verdict_rows(view)), document.figures(figures)]
        parts += [document.table(each.title, each.headings, each.rows, each.note) for each in make_tables(view)]
    parts.append(document.text("How to read this", METHOD))
    return write_atomic(folder / PAGE, document.page("perdure home: does the home stay in order?", parts, command))


def _verdict_rows(view: DayView) -> list[VerdictRow]:
    """Return the verdicts that homes have, each with their number."""
    counts = Counter(view.homes["verdict"].to_list())
    found = []
    for each in home_outcomes():
        if counts[each.name]:
            who = wording.count(counts[each.name], "home")
            found.append(VerdictRow(Chip(each.name, each.page_color), who, (Chip(each.meaning),)))
    return found
