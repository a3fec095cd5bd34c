"""Release strategies side by side: the tables of one task and split in words, from the tables of `analysis`.

Everything here is a function of frames, whether logs were analyzed just now or the frames were read from CSV files.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import TYPE_CHECKING, Any, NamedTuple

from perdure.errors import PerdureError
from perdure.home.evaluate.analysis import GROUP, SAME_EPISODE, paired_difference
from perdure.home.evaluate.log import UNTRAINED
from perdure.home.evaluate.outcomes import (
    COUNTINGS,
    DID_NOT_LAST,
    DROPPED_HEIGHT,
    FAILURE_CAUSES,
    OTHER,
    SUCCESS,
    THROWN_SPEED,
    Counting,
)
from perdure.home.evaluate.policies import ReleaseChoice, read_release
from perdure.home.evaluate.strategy import COLUMNS, Strategy
from perdure.home.sim.objects import short_name
from perdure.home.tasks.planners import OpenLoop
from perdure.home.tasks.tasks import PAST, STAGES, Stage, get_task
from perdure.report import charts
from perdure.report.charts import Marker, slug
from perdure.stats import FEWEST_FOR_INTERVAL

if TYPE_CHECKING:
    import polars as pl

WORDS: dict[Counting, str] = {"latched": "latched (benchmark)", "stabilizing": "goal-stabilizing (thesis)"}
LAST = ("counted, did not last", "final state", "of these policies alone", "diverged")
OUTCOMES = {
    SUCCESS: "every object stayed",
    DID_NOT_LAST: "counted as success, but an object left later",
    OTHER: "failed in another stage",
}


def describe(strategy: Strategy, with_setting: bool = True) -> str:
    """Return what is run in words: "stop, lower 5 cm, drag only"; `place` itself where it is not ours.

    `with_setting` adds world, planner and fallback where they are not the usual ones.
    """
    choice = known_release(strategy.place)
    words = strategy.place if choice is None else choice.words
    setting = strategy.setting if with_setting else ""
    return ", ".join(filter(None, (words, setting, strategy.label)))


def known_release(place: str) -> ReleaseChoice | None:
    """Return the release choice of a name in logs; None where another simulator gave it."""
    try:
        return read_release(place)
    except PerdureError:
        return None


def ordered(strategies: Iterable[Strategy]) -> list[Strategy]:
    """Return strategies by world, planner and fallback, the usual ones first; then by release strategy and label."""

    def rank(strategy: Strategy) -> tuple[Any, ...]:
        choice = known_release(strategy.place)
        release = (math.inf, 0) if choice is None else choice.rank
        planner = (strategy.planner != OpenLoop.name, strategy.planner)
        setting = (strategy.world, *planner, strategy.fallback == "none")
        return *setting, *release, strategy.place, strategy.label

    return sorted(set(strategies), key=rank)


def describe_stage(each: Stage, unmet: bool = False) -> str:
    """Return the state in which a stage is reached, "pick_0" -> "object 1 picked"; unmet: "object 1 not picked"."""
    past = PAST[each.verb]
    containers = [found.container for found in each.conditions if found.name == past]
    thing = containers[-1] if containers else f"object {each.target + 1}"
    return f"{thing} {'not ' if unmet else ''}{past}"


def describe_outcome(name: str) -> str:
    """Return what became of an episode, see `outcomes.outcome`: "place_1" -> "object 2 did not stay"."""
    return OUTCOMES.get(name) or f"object {STAGES[name].target + 1} did not stay"


def describe_kind(name: str, cylinder: bool) -> str:
    """Return the name of an object: "013_apple" -> "apple", with "(cylinder)" for cans."""
    return f"{short_name(name)} (cylinder)" if cylinder else short_name(name)


def describe_task(name: str) -> str:
    """Return a task as the benchmark writes it: "set_table" -> "SetTable"."""
    return name.title().replace("_", "")


def percent(share: float | None, digits: int = 1) -> str:
    """Return a share in percent: 0.917 -> "91.7 %"; nothing for None."""
    return "" if share is None else f"{100 * share:.{digits}f} %"


def listed(words: Sequence[str]) -> str:
    """Return words as a list: "a, b and c"."""
    return " and ".join(filter(None, (", ".join(words[:-1]), words[-1])))


@dataclass(frozen=True)
class Table:
    """A table of text with its title and note."""

    title: str
    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""

    @property
    def text(self) -> str:
        """For a terminal."""
        rows = [self.headings, *self.rows]
        widths = [max(len(row[k]) for row in rows) for k in range(len(self.headings))]
        lines = ["  ".join((row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:]))).rstrip() for row in rows]
        return "\n".join([self.title, *(f"  {line}" for line in lines)])


@dataclass(frozen=True)
class View:
    """The tables of one task and split, and how its release strategies are shown."""

    task: str
    split: str
    strategies: tuple[Strategy, ...]
    """In the order in which they are shown."""
    styles: tuple[charts.Style, ...]
    tables: Mapping[str, pl.DataFrame]
    """Tables of `Analysis` and others by name, with the rows of this task and split."""

    @property
    def name(self) -> str:
        """Such as `set-table-val`, for files and anchors."""
        return slug(self.task, self.split)

    @property
    def title(self) -> str:
        """Such as "SetTable, val, drag only"."""
        return ", ".join(filter(None, (describe_task(self.task), self.split, self.setting)))

    @property
    def setting(self) -> str:
        """World, planner and fallback that all strategies share, in words; "" for the usual ones."""
        settings = {strategy.setting for strategy in self.strategies}
        return settings.pop() if len(settings) == 1 else ""

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """Their words in figures; what all share is in `setting`."""
        return tuple(describe(strategy, with_setting=not self.setting) for strategy in self.strategies)

    @property
    def names(self) -> tuple[str, ...]:
        """Their short names in tables."""
        return tuple(strategy.name for strategy in self.strategies)

    @property
    def shown(self) -> Iterator[tuple[Strategy, str, charts.Style]]:
        """Every strategy, its label and style."""
        return zip(self.strategies, self.labels, self.styles, strict=True)

    def rows(self, table: str, strategy: Strategy, **equal: Any) -> pl.DataFrame:
        """Return the rows of a strategy in a table; none where there is no such table."""
        if table not in self.tables:
            return next(iter(self.tables.values())).clear()
        return self.tables[table].filter(**asdict(strategy), **equal)

    def success(self, strategy: Strategy) -> dict[str, Any]:
        """Return the row of a strategy in `Analysis.success`."""
        return self.rows("success", strategy).row(0, named=True)

    def units(self, strategy: Strategy) -> tuple[bool, int]:
        """Return whether training seeds (else episodes) are the units of the intervals, and their number."""
        row = self.success(strategy)
        if (seeds := row["train_seeds"]) > 1:
            return True, seeds
        if "episodes" not in self.tables:  # a committed table of finished rows knows no more than their number
            return False, row["episodes"] // row["eval_seeds"]
        return False, self.rows("episodes", strategy)["index"].n_unique()

    def has_interval(self, strategy: Strategy) -> bool:
        """Return whether a strategy has enough units to draw intervals."""
        return self.units(strategy)[1] >= FEWEST_FOR_INTERVAL


def make_views(tables: Mapping[str, pl.DataFrame]) -> tuple[View, ...]:
    """Return a view of each task and split in the table `success`. A strategy has the same style in all of them."""
    found: dict[tuple[str, str], list[Strategy]] = {}
    for row in tables["success"].select(GROUP).to_dicts():
        strategy = Strategy(**{name: row[name] for name in COLUMNS})
        found.setdefault((row["task"], row["split"]), []).append(strategy)
    order = ordered(strategy for strategies in found.values() for strategy in strategies)
    views = []
    for (task, split), strategies in found.items():
        shown = tuple(strategy for strategy in order if strategy in strategies)
        styles = tuple(charts.style(order.index(strategy)) for strategy in shown)
        here = {name: table.filter(task=task, split=split) for name, table in tables.items()}
        views.append(View(task, split, shown, styles, here))
    return tuple(views)


def make_tables(view: View) -> list[Table]:
    """Return all tables of one task and split; those with nothing to show are left out."""
    makers = (success_table, paired_table, mode_table, placement_table, release_table, hand_over_table, policy_table)
    return [table for make in makers if (table := make(view)) is not None]


def verdict(view: View) -> str:
    """Return one sentence: how often the whole task succeeded and stayed so, and what the benchmark counts."""
    rows = [view.success(strategy) for strategy in view.strategies]
    pairs = zip(view.labels, rows, strict=True)
    stayed = "; ".join(f"{label} {percent(row['stabilizing mean'])}" for label, row in pairs)
    counted = listed([percent(row["latched mean"]) for row in rows])
    return f"Episodes in which every object stayed: {stayed}. The benchmark counts {counted}."


def mode_labels(view: View, counting: Counting) -> list[tuple[str, str]]:
    """Return every (stage, cause) that any strategy has, in the task's order."""
    import polars as pl

    table = pl.concat([view.rows("modes", strategy, counting=counting) for strategy in view.strategies])
    stages = [stage.name for stage in get_task(view.task).stages]
    found = set(table.select("stage", "cause").rows())
    return sorted(found, key=lambda each: (stages.index(each[0]), FAILURE_CAUSES.index(each[1])))


class Measure(NamedTuple):
    """Something measured at the release, a column of `Analysis.placements`."""

    title: str
    """Of its figure; "" for none."""
    axis: str
    heading: str
    """In the table."""
    scale: float = 1.0
    """From the column's unit to the table's."""
    digits: int = 3
    log: bool = False
    marker: Marker | None = None
    """A threshold of the failure causes."""


MEASURES = {
    "release_height": Measure(
        "Height of the object at the release",
        "middle of the object above where it would rest [m]",
        "height above rest [mm]",
        scale=1000.0,
        digits=0,
        marker=Marker(DROPPED_HEIGHT, "dropped from here on"),
    ),
    "object_speed": Measure(
        "Speed of the object at the release",
        "speed of the object [m/s]",
        "speed of the object [m/s]",
        log=True,
        marker=Marker(THROWN_SPEED, "limit for thrown"),
    ),
    "gripper_speed": Measure("", "", "of the gripper point [m/s]"),
    "base_speed": Measure("Speed of the base at the release", "speed of the base [m/s]", "of the base [m/s]", log=True),
    "tilt": Measure("Tilt of the object at the release", "angle from upright [deg]", "tilt [deg]", digits=0),
}


def success_table(view: View) -> Table:
    """Return the success of every strategy, and its successes that did not last."""
    rows = []
    units = set()
    for strategy, label, _ in view.shown:
        row = view.success(strategy)
        outcomes = dict(view.rows("outcomes", strategy).select("outcome", "count").iter_rows())
        latched = outcomes[SUCCESS] + outcomes[DID_NOT_LAST]
        trained = str(row["train_seeds"])
        if set(view.rows("seeds", strategy)["train_seed"]) == {UNTRAINED}:
            trained = "untrained"
        cells = [strategy.name, label, f"{row['episodes']:,}", f"{trained} x {row['eval_seeds']}"]
        cells += [interval_text(row, counting) for counting in COUNTINGS]
        cells += [f"{row['did_not_last']} of {latched}"]
        cells += [str(row[name]) for name in ("final", "unaided", "diverged")]
        rows.append(cells)
        units.add((view.units(strategy)[0], row["method"]))
    words = (
        "over episodes where there is one training seed: it says nothing about training again",
        "over training seeds",
    )
    over = ", ".join(f"{words[seeds]} ({method})" for seeds, method in sorted(units, reverse=True))
    seeds = "training x evaluation seeds"
    headings = ("release strategy", "in the figures", "episodes", seeds, *WORDS.values(), *LAST)
    note = (
        f"Mean +- standard error over runs (none for one run) [95 % interval {over}]. Counted, did not last: the "
        "benchmark counts the episode as a success, yet an object was outside its goal at some step after its place "
        "ended. Final state: all targets in their goals and an empty hand in all of the last five seconds. Policies "
        "alone: no scripted skill acted."
    )
    return Table("Success", headings, rows, note)


def interval_text(row: Mapping[str, Any], counting: str, digits: int = 1) -> str:
    """Return a success with standard error and 95 % interval: "50.0 +- 14.4 % [12.3, 87.7]"."""
    found = (row[f"{counting} {name}"] for name in ("mean", "standard_error", "lower", "upper"))
    mean, error, low, high = (math.nan if value is None else 100 * value for value in found)
    spread = "" if math.isnan(error) else f" +- {error:.1f}"
    return f"{mean:.1f}{spread} %" + ("" if math.isnan(low) else f" [{low:.{digits}f}, {high:.{digits}f}]")


def paired_table(view: View) -> Table | None:
    """Return pairwise comparisons on the episodes that both strategies ran; nothing for a single strategy."""
    rows = []
    for first, second in combinations(view.strategies, 2):
        left = view.rows("episodes", first)
        right = view.rows("episodes", second)
        both = left.join(right, on=SAME_EPISODE)
        if both.is_empty():
            continue
        before = both["stabilizing"]
        after = both["stabilizing_right"]
        found = paired_difference(left, right)
        change, low, high = (100 * float(each) for each in (found.estimate, found.lower, found.upper))
        points = f"{change:+.1f} points" + ("" if math.isnan(low) else f" [{low:+.1f}, {high:+.1f}]")
        counts = (len(both), (after & ~before).sum(), (before & ~after).sum())
        rows.append((f"{second.name} against {first.name}", *(f"{count:,}" for count in counts), points))
    if not rows:
        return None
    note = (
        "Goal-stabilizing success of the same training seed from the same start. Mean difference [95 % interval over "
        "training seeds, Student t; over episodes where there is one training seed]. Not corrected for the number of "
        "comparisons."
    )
    headings = ("release strategies", "same episodes", "better", "worse", "mean difference")
    return Table("The same episodes under two release strategies", headings, rows, note)


def mode_table(view: View) -> Table | None:
    """Return the count and both shares of every failure mode, for every strategy and way of counting."""
    rows = []
    for counting in COUNTINGS:
        for stage, cause in mode_labels(view, counting):
            cells = []
            for strategy in view.strategies:
                found = view.rows("modes", strategy, counting=counting, stage=stage, cause=cause)
                cells += ["0"] if found.is_empty() else [_shares(*found.select("count", "of_all", "of_failed").row(0))]
            rows.append((WORDS[counting], stage, cause, *cells))
    headings = ("counting", "first unmet stage", "failure cause", *view.names)
    note = "Count (share of all episodes, share of the failed ones)."
    return Table("Failure modes", headings, rows, note) if rows else None


def _shares(count: int, *shares: float | None) -> str:
    return f"{count} ({', '.join(percent(share) for share in shares if share is not None)})"


def by_shape(view: View, strategy: Strategy) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return (placements, those that did not stay) of cylinders, and of other objects (thesis, figure 2-5).

    A share of failures alone would not say whether cylinders fail more often or are only placed more often.
    """
    parts = (view.rows("kinds", strategy, cylinder=cylinder) for cylinder in (True, False))
    cylinders, others = ((int(part["placements"].sum()), int(part["failures"].sum())) for part in parts)
    return cylinders, others


def placement_table(view: View) -> Table:
    """Return placements that did not stay by strategy: of all objects, of cylinders and of the others."""
    rows = []
    for strategy in view.strategies:
        shapes = by_shape(view, strategy)
        totals = tuple(map(sum, zip(*shapes, strict=True)))
        cells = [_failed(*shape) if shape[0] else "none" for shape in shapes]
        shares = [part / total if total else None for part, total in zip(shapes[0], totals, strict=True)]
        rows.append((strategy.name, _failed(*totals), *cells, *map(percent, shares)))
    shown = ("did not stay", "cylinders", "other objects", "cylinders of all placed", "of those that left")
    note = "Did not stay: not goal-stabilizing, of so many placements."
    return Table("Placements", ("strategy", *shown), rows, note)


def _failed(placements: int, failures: int) -> str:
    return f"{failures} of {placements} ({percent(failures / placements)})" if placements else "0"


def release_table(view: View) -> Table:
    """Return median and 10 to 90 % range of height, speeds and tilt at the release."""
    rows = []
    for strategy in view.strategies:
        placements = view.rows("placements", strategy)
        cells = []
        for column, each in MEASURES.items():
            found = [placements[column].quantile(level, "linear") for level in (0.5, 0.1, 0.9)]
            known = [f"{each.scale * value:.{each.digits}f}" for value in found if value is not None]
            cells.append("{} ({} to {})".format(*known) if known else "")
        rows.append((strategy.name, str(len(placements)), *cells))
    headings = ("release strategy", "placements", *(each.heading for each in MEASURES.values()))
    return Table("At the release", headings, rows, "Median (10 % to 90 %).")


def hand_over_table(view: View) -> Table | None:
    """Return the counts of hand-over outcomes; nothing where no logs record them."""
    table = view.tables["hand_overs"]
    outcomes = sorted(set(table["outcome"]))
    rows = []
    for strategy in view.strategies:
        counts = dict(view.rows("hand_overs", strategy).select("outcome", "count").iter_rows())
        if counts:
            rows.append((strategy.name, *(str(counts.get(each, 0)) for each in outcomes)))
    note = "Done: the whole motion ran. Anything else is a fall-back: the object was let go at rest, where it was."
    title = "Release strategies: how the motion went"
    return Table(title, ("release strategy", *outcomes), rows, note) if outcomes else None


def policy_table(view: View) -> Table:
    """Return which policy acted in which skill."""
    rows = []
    for skill in dict.fromkeys(view.tables["policies"]["skill"]) or ["every skill"]:
        names = [view.rows("policies", strategy, skill=skill)["policy"].to_list() for strategy in view.strategies]
        words = [["scripted oracle" if name == "oracle" else name for name in each] for each in names]
        rows.append((skill, *(", ".join(each) or "not recorded" for each in words)))
    note = "The scripted oracle knows the whole world; a learned policy sees what the skill's table says."
    return Table("Policies", ("skill", *view.names), rows, note)


def summary(view: View) -> str:
    """Return the main tables as text for a terminal."""
    stages = []
    for stage in get_task(view.task).stages:
        cells = [view.rows("stages", strategy, stage=stage.name)["mean"] for strategy in view.strategies]
        stages.append((stage.name, *(", ".join(map(percent, each)) for each in cells)))
    tables = [Table(f"Success per stage ({', '.join(COUNTINGS)})", ("stage", *view.names), stages)]
    success = success_table(view)
    sides = list(zip(success.headings[1:], *(row[1:] for row in success.rows), strict=True))
    tables.append(replace(success, headings=("", *view.names), rows=sides))
    tables += [*filter(None, [mode_table(view)]), placement_table(view)]
    return "\n\n".join([f"{view.title}\n{verdict(view)}", *(table.text for table in tables)])
