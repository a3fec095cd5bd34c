"""Analysis of logs: tables of success, failure modes and placements."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from perdure.home.evaluate.log import EpisodeLog
from perdure.home.evaluate.outcomes.counting import latched, stages_stabilizing
from perdure.home.evaluate.outcomes.files import check_distinct
from perdure.home.evaluate.outcomes.labels import failure_table, mode_table, outcome, outcome_table
from perdure.home.evaluate.outcomes.measures import stage_table
from perdure.home.evaluate.outcomes.placements import IDENTITY, kind_table, placement_table, shape_table

if TYPE_CHECKING:
    import polars as pl


@dataclass(frozen=True)
class Analysis:
    """Tables made of logs. All of them are ordered by task, split and strategy."""

    episodes: pl.DataFrame
    """One row per episode: identity, `success` (latched), `stabilizing` (the task's success with every placement
    goal-stabilizing), `outcome`, `seconds`, `settle_seconds`, `force` (largest in [N]; nan if unknown), `diverged`."""
    stages: pl.DataFrame
    """Success per stage over runs, both ways of counting (figure 2-2); see `stage_table`."""
    outcomes: pl.DataFrame
    """Successes, those that did not last, failures by placement (figures 2-1, 2-3); see `outcome_table`."""
    failures: pl.DataFrame
    """The label of every failed episode; see `failure_table`."""
    modes: pl.DataFrame
    """How often each label was given; see `mode_table`."""
    placements: pl.DataFrame
    """One row per placement; see `placement_table`."""
    kinds: pl.DataFrame
    """Placements by object kind."""
    shapes: pl.DataFrame
    """Placements of cylinders and others (figure 2-5); see `shape_table`."""

    def summary(self) -> str:
        """Return the tables as plain text, for a terminal."""
        from perdure.home.evaluate.outcomes.text import summary_text

        return summary_text(self)

    def figures(self) -> dict[str, pl.DataFrame]:
        """Return the data of the thesis' figures by name."""
        return {
            "success per stage": self.stages,
            "outcomes": self.outcomes,
            "failure modes": self.modes,
            "placements by kind": self.kinds,
            "placements by shape": self.shapes,
        }


def analyze(logs: Sequence[EpisodeLog], seed: int = 0) -> Analysis:
    """Analyze logs of any tasks, splits, strategies and seeds together; `seed` is the bootstrap's.

    Raises:
        HomeError: If there are no logs, or one episode of one strategy and its seeds is there twice.
    """
    check_distinct(logs, "the logs")
    logs = sorted(logs, key=lambda log: log.key)
    episodes, placements, failures = _episode_table(logs), placement_table(logs), failure_table(logs)
    return Analysis(
        episodes=episodes,
        stages=stage_table(logs, np.random.default_rng(seed)),
        outcomes=outcome_table(episodes),
        failures=failures,
        modes=mode_table(failures, episodes),
        placements=placements,
        kinds=kind_table(placements),
        shapes=shape_table(placements),
    )


def _largest_force(log: EpisodeLog) -> float:
    known = [run.force for run in log.runs if not math.isnan(run.force)]
    return max(known, default=math.nan if log.runs else 0.0)


def _episode_table(logs: Sequence[EpisodeLog]) -> pl.DataFrame:
    import polars as pl

    rows = [
        {
            **{name: getattr(log, name) for name in IDENTITY},
            "success": latched(log)[-1],
            "stabilizing": stages_stabilizing(log)[-1],
            "outcome": outcome(log),
            "seconds": log.steps / log.control_hz,
            "settle_seconds": (log.length - log.steps) / log.control_hz,
            "force": _largest_force(log),
            "diverged": log.diverged,
        }
        for log in logs
    ]
    return pl.DataFrame(rows)
