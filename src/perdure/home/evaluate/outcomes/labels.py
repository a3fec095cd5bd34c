"""Labels of failed episodes: first unmet stage and failure cause, and their frequencies.

Both ways of counting have their own labels: *latched*, as the benchmark counts success, and *goal-stabilizing*, as the
thesis counts placements.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from perdure.home.benchmark.tasks import Predicate, get_task
from perdure.home.evaluate.log import EpisodeLog
from perdure.home.evaluate.outcomes.counting import blamed, latched, stages_stabilizing
from perdure.home.evaluate.outcomes.failure_causes import FAILURE_CAUSES, FailureCause, failure_cause
from perdure.home.evaluate.outcomes.placements import GROUP, IDENTITY

if TYPE_CHECKING:
    import polars as pl

Counting = Literal["latched", "stabilizing"]
COUNTINGS: tuple[Counting, ...] = ("latched", "stabilizing")
SUCCESS, DID_NOT_LAST, OTHER = "success", "success that did not last", "other"


@dataclass(frozen=True)
class Label:
    """Why an episode failed."""

    stage: str
    """First unmet stage."""
    cause: FailureCause
    target: int
    """Number of the object: the one that is not in its goal, else that of the stage."""


def label(log: EpisodeLog, counting: Counting) -> Label | None:
    """Return the label of an episode, None when it succeeded by this way of counting."""
    reached = latched(log)
    counted = reached if counting == "latched" else stages_stabilizing(log)
    if all(counted):
        return None
    number = counted.index(False)
    stage = log.home_task.stages[number]
    condition = Predicate("at", stage.placed) if reached[number] else blamed(log, number)
    target = int(stage.name.partition("_")[2])
    if condition is not None and condition.name == "at" and condition.target is not None:
        target = condition.target
    return Label(stage.name, failure_cause(log, number, condition), target)


def outcome(log: EpisodeLog) -> str:
    """Return the outcome of an episode in the categories of the thesis' figures 2-1 and 2-3.

    `success`, or `success that did not last`: the benchmark counts it, but a placement is not goal-stabilizing. Of the
    failed ones: `place_k` when the first stage that does not count, placements being goal-stabilizing, is that one;
    else `other`.
    """
    if all(latched(log)):
        return SUCCESS if all(stages_stabilizing(log)) else DID_NOT_LAST
    stage = log.home_task.stages[stages_stabilizing(log).index(False)]
    return OTHER if stage.placed is None else stage.name


def failure_table(logs: Sequence[EpisodeLog]) -> pl.DataFrame:
    """Return one row per way of counting and episode that fails by it: identity, counting, stage, cause, target."""
    import polars as pl

    rows = []
    for counting in COUNTINGS:
        for log in logs:
            found = label(log, counting)
            if found is not None:
                rows.append({**{n: getattr(log, n) for n in IDENTITY}, "counting": counting, **vars(found)})
    kinds = (pl.String, pl.String, pl.String, pl.Int64, pl.Int64, pl.Int64, pl.String)
    extra = {"counting": pl.String, "stage": pl.String, "cause": pl.String, "target": pl.Int64}
    return pl.DataFrame(rows, schema={**dict(zip(IDENTITY, kinds, strict=True)), **extra})


def mode_table(failures: pl.DataFrame, episodes: pl.DataFrame) -> pl.DataFrame:
    """Return the `count` of each label, its share `of_all` episodes and `of_failed` ones."""
    import polars as pl

    keys = [*GROUP, "counting"]
    counted = failures.group_by([*keys, "stage", "cause"]).agg(count=pl.len().cast(pl.Int64))
    everything = episodes.group_by(GROUP).agg(episodes=pl.len().cast(pl.Int64))
    shares = counted.join(everything, on=GROUP).with_columns(
        of_all=pl.col("count") / pl.col("episodes"), of_failed=pl.col("count") / pl.col("count").sum().over(keys)
    )
    place = [_stage_number(task, stage) for task, stage in shares.select("task", "stage").iter_rows()]
    word = [FAILURE_CAUSES.index(cause) for cause in shares["cause"]]
    order = [pl.Series("_stage", place, pl.Int64), pl.Series("_word", word, pl.Int64)]
    return shares.with_columns(order).sort([*keys, "_stage", "_word"]).drop("_stage", "_word", "episodes")


def outcome_table(episodes: pl.DataFrame) -> pl.DataFrame:
    """Return the `count` of each outcome, its share `of_all` episodes, and `of_failed` ones (null for successes)."""
    import polars as pl

    rows = []
    for group, part in episodes.group_by(GROUP, maintain_order=True):
        found = part["outcome"].to_list()
        failed = sum(each not in (SUCCESS, DID_NOT_LAST) for each in found)
        places = [stage.name for stage in get_task(str(group[0])).stages if stage.placed is not None]
        for name in (SUCCESS, DID_NOT_LAST, *places, OTHER):
            count = found.count(name)
            share = count / failed if failed and name not in (SUCCESS, DID_NOT_LAST) else None
            rows.append((*group, name, count, count / len(found), share))
    kinds = {"outcome": pl.String, "count": pl.Int64, "of_all": pl.Float64, "of_failed": pl.Float64}
    return pl.DataFrame(rows, schema={**dict.fromkeys(GROUP, pl.String), **kinds}, orient="row")


def _stage_number(task: str, stage: str) -> int:
    return [each.name for each in get_task(task).stages].index(stage)
