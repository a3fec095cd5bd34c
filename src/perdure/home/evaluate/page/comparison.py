"""The arms of one task and split side by side: their tables, their order, how figures show them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from perdure.home.agents.release import ARMS
from perdure.home.benchmark.tasks import HomeTask, get_task
from perdure.home.evaluate.outcomes import Analysis, Counting
from perdure.home.evaluate.page import words
from perdure.report.statistics import FEWEST_FOR_INTERVAL, TRAINING_SEEDS
from perdure.report.theme import Style, style

if TYPE_CHECKING:
    import polars as pl


@dataclass(frozen=True)
class Comparison:
    """What the logs of one task and split say, arm by arm."""

    analysis: Analysis
    """Of everything; the properties below hold what belongs to this task and split."""
    task: str
    split: str
    arms: tuple[str, ...]
    """In the order in which they are shown."""
    styles: tuple[Style, ...]
    """One for each arm."""

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
        """What figures call the arms; a world that all share is in `world`."""
        return tuple(words.strategy(arm, with_world=not self.world) for arm in self.arms)

    @property
    def world(self) -> str:
        """In words, what differs from the usual world for all arms alike; "" where that is nothing."""
        worlds = {words.world(arm) for arm in self.arms}
        return worlds.pop() if len(worlds) == 1 else ""

    @cached_property
    def episodes(self) -> dict[str, pl.DataFrame]:
        """Episodes by arm, see `Analysis.episodes`."""
        return self._split(self.analysis.episodes)

    @cached_property
    def stages(self) -> dict[str, pl.DataFrame]:
        """Success per stage by arm, both ways of counting."""
        return self._split(self.analysis.stages)

    @cached_property
    def outcomes(self) -> dict[str, pl.DataFrame]:
        """Outcomes by arm."""
        return self._split(self.analysis.outcomes)

    @cached_property
    def modes(self) -> dict[str, pl.DataFrame]:
        """Failure modes by arm, both ways of counting."""
        return self._split(self.analysis.modes)

    @cached_property
    def placements(self) -> dict[str, pl.DataFrame]:
        """Placements by arm."""
        return self._split(self.analysis.placements)

    @cached_property
    def kinds(self) -> dict[str, pl.DataFrame]:
        """Placements by object kind, by arm."""
        return self._split(self.analysis.kinds)

    @cached_property
    def shapes(self) -> dict[str, pl.DataFrame]:
        """Placements of cylinders and others, by arm."""
        return self._split(self.analysis.shapes)

    def final(self, arm: str, counting: Counting) -> dict[str, float]:
        """The row of `stages` with the task's success: `mean`, `standard_error`, `lower`, `upper`, `runs`, ..."""
        return self.stages[arm].filter(counting=counting).row(-1, named=True)

    def units(self, arm: str) -> tuple[bool, int]:
        """Whether training seeds are the units of an arm's intervals, rather than episodes, and how many there are."""
        episodes = self.episodes[arm]
        if str(self.final(arm, "latched")["units"]) == TRAINING_SEEDS:
            return True, episodes["train_seed"].n_unique()
        return False, len(episodes)

    def has_intervals(self, arm: str) -> bool:
        """Whether figures draw the arm's intervals: they are over enough units."""
        return self.units(arm)[1] >= FEWEST_FOR_INTERVAL

    def last_left(self, arm: str) -> int:
        """Episodes that the benchmark counts as success although the object placed last left its goal afterwards."""
        import polars as pl

        last = max(stage.placed for stage in self.home_task.stages if stage.placed is not None)
        left = self.placements[arm].filter(~pl.col("stabilizing"), target=last)
        keys = ["train_seed", "eval_seed", "index"]
        return len(self.episodes[arm].filter("success").join(left.select(keys), on=keys, how="semi"))

    def _split(self, table: pl.DataFrame) -> dict[str, pl.DataFrame]:
        here = table.filter(task=self.task, split=self.split)
        return {arm: here.filter(arm=arm) for arm in self.arms}


def comparisons(analysis: Analysis) -> tuple[Comparison, ...]:
    """One for each task and split, in the analysis' order. An arm has the same style in all of them."""
    rows = analysis.episodes.select("task", "split", "arm").unique(maintain_order=True).rows()
    order = ordered({arm for _, _, arm in rows})
    found = []
    for task, split in dict.fromkeys((task, split) for task, split, _ in rows):
        arms = tuple(arm for arm in order if (task, split, arm) in rows)
        styles = tuple(style(order.index(arm)) for arm in arms)
        found.append(Comparison(analysis, task, split, arms, styles))
    return tuple(found)


def ordered(arms: set[str]) -> list[str]:
    """The policy alone, then what was trained to make objects stay, the hand-overs, whatever else there is.

    What differs from the usual world, as in `ik drag`, comes after all that does not.
    """

    def place(arm: str) -> tuple[str, int, int, str]:
        name, _, world = arm.partition(" ")
        if delta := re.match(r"delta-(\d+)", name):
            return world, 1, int(delta[1]), name
        return world, 2 * (ARMS.index(name) if name in ARMS else len(ARMS)), 0, name

    return sorted(arms, key=place)


def percent(share: float) -> str:
    """0.917 -> "91.7 %"."""
    return f"{100 * share:.1f} %"


def listed(words: Sequence[str]) -> str:
    """a, b and c."""
    return " and ".join(filter(None, (", ".join(words[:-1]), words[-1])))
