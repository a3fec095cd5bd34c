"""The release strategies of one task and split side by side: tables, order, labels and styles."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from perdure.home.agents.release import STRATEGIES
from perdure.home.benchmark.tasks import HomeTask, get_task
from perdure.home.evaluate.outcomes import Analysis, Counting
from perdure.home.evaluate.page import words
from perdure.report.statistics import FEWEST_FOR_INTERVAL, TRAINING_SEEDS
from perdure.report.theme import Style, style

if TYPE_CHECKING:
    import polars as pl

_TABLES = ("episodes", "stages", "outcomes", "modes", "placements", "kinds", "shapes")


@dataclass(frozen=True)
class Comparison:
    """The tables of one task and split by release strategy."""

    task: str
    split: str
    strategies: tuple[str, ...]
    """Names in logs, in the order in which they are shown."""
    styles: tuple[Style, ...]
    """One for each strategy."""
    episodes: dict[str, pl.DataFrame]
    """This and the following: the tables of `Analysis`, by strategy."""
    stages: dict[str, pl.DataFrame]
    outcomes: dict[str, pl.DataFrame]
    modes: dict[str, pl.DataFrame]
    placements: dict[str, pl.DataFrame]
    kinds: dict[str, pl.DataFrame]
    shapes: dict[str, pl.DataFrame]

    @property
    def home_task(self) -> HomeTask:
        """The task."""
        return get_task(self.task)

    @property
    def name(self) -> str:
        """Such as `set-table-val`, for files and anchors."""
        return f"{self.task}-{self.split}".replace("_", "-")

    @property
    def labels(self) -> tuple[str, ...]:
        """Their words in figures; settings that all share are in `world`."""
        return tuple(words.describe(strategy, with_world=not self.world) for strategy in self.strategies)

    @property
    def world(self) -> str:
        """Settings that differ from the default for all strategies alike, in words; "" for none."""
        worlds = {words.world(strategy) for strategy in self.strategies}
        return worlds.pop() if len(worlds) == 1 else ""

    def final(self, strategy: str, counting: Counting) -> dict[str, float]:
        """Return the row of `stages` with the task's success: `mean`, `standard_error`, `lower`, `upper`, ..."""
        return self.stages[strategy].filter(counting=counting).row(-1, named=True)

    def units(self, strategy: str) -> tuple[bool, int]:
        """Return whether training seeds (else episodes) are the units of the intervals, and their number."""
        episodes = self.episodes[strategy]
        if str(self.final(strategy, "latched")["units"]) == TRAINING_SEEDS:
            return True, episodes["train_seed"].n_unique()
        return False, len(episodes)

    def has_intervals(self, strategy: str) -> bool:
        """Return whether a strategy has enough units to draw intervals."""
        return self.units(strategy)[1] >= FEWEST_FOR_INTERVAL

    def last_left(self, strategy: str) -> int:
        """Return the number of latched successes whose last placed object left its goal afterwards."""
        import polars as pl

        last = max(stage.placed for stage in self.home_task.stages if stage.placed is not None)
        left = self.placements[strategy].filter(~pl.col("stabilizing"), target=last)
        keys = ["train_seed", "eval_seed", "index"]
        return len(self.episodes[strategy].filter("success").join(left.select(keys), on=keys, how="semi"))


def comparisons(analysis: Analysis) -> tuple[Comparison, ...]:
    """Return one for each task and split, in the analysis' order. A strategy has the same style in all of them."""
    rows = analysis.episodes.select("task", "split", "strategy").unique(maintain_order=True).rows()
    order = ordered({strategy for _, _, strategy in rows})
    found = []
    for task, split in dict.fromkeys((task, split) for task, split, _ in rows):
        strategies = tuple(strategy for strategy in order if (task, split, strategy) in rows)
        styles = tuple(style(order.index(strategy)) for strategy in strategies)
        tables = {}
        for name in _TABLES:
            here = getattr(analysis, name).filter(task=task, split=split)
            tables[name] = {strategy: here.filter(strategy=strategy) for strategy in strategies}
        found.append(Comparison(task, split, strategies, styles, **tables))
    return tuple(found)


def ordered(strategies: set[str]) -> list[str]:
    """Return strategies in order: the policy alone, policies trained to make objects stay, hand-overs, others.

    Strategies in other worlds, such as `ik drag`, come after all in the default world.
    """

    def place(strategy: str) -> tuple[str, int, int, str]:
        name, _, world = strategy.partition(" ")
        if delta := re.match(r"delta-(\d+)", name):
            return world, 1, int(delta[1]), name
        return world, 2 * (STRATEGIES.index(name) if name in STRATEGIES else len(STRATEGIES)), 0, name

    return sorted(strategies, key=place)


def percent(share: float) -> str:
    """Return a share in percent: 0.917 -> "91.7 %"."""
    return f"{100 * share:.1f} %"


def listed(words: Sequence[str]) -> str:
    """Return words as a list: "a, b and c"."""
    return " and ".join(filter(None, (", ".join(words[:-1]), words[-1])))
