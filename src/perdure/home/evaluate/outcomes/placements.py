"""Placements, one per row: how the object was released, where it went, why it did not stay."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from perdure.home.evaluate.log import EpisodeLog
from perdure.home.evaluate.outcomes.counting import handled, stabilizing
from perdure.home.evaluate.outcomes.failure_causes import (
    in_goal_since,
    placement,
    placement_cause,
    release_offset,
    tilt,
)

if TYPE_CHECKING:
    import polars as pl

STAYED = "stayed"
"""Value of `cause` where a placement is goal-stabilizing."""
IDENTITY = ("task", "split", "strategy", "train_seed", "eval_seed", "index", "episode_hash")
GROUP = ("task", "split", "strategy")


def placement_table(logs: Sequence[EpisodeLog]) -> pl.DataFrame:
    """Return one row per placement; a target that was never released while the plan handled it has none.

    | column | meaning |
    |---|---|
    | task, split, strategy, train_seed, eval_seed, index, episode_hash, target | which |
    | kind, cylinder | the object |
    | skill, forced | in which skill it was let go; whether the hand was opened by force |
    | release_height | where its middle was let go, above where it would rest in its goal [m] |
    | release_offset | the same in the plane [m] |
    | tilt | angle of its z axis from upright at the release [deg] |
    | object_speed, gripper_speed, base_speed | at the release [m/s] |
    | in_goal_release, in_goal_skill_end | in its goal when it was let go, at the last step of its place skill |
    | in_goal_end, in_goal_settled | ... of the episode, of the settling time |
    | stabilizing | whether the placement is goal-stabilizing |
    | displacement, fall | its way from the release to the last step of its track: in the plane, downwards [m] |
    | cause | see `causes`; `stayed` where it is goal-stabilizing |
    """
    import polars as pl

    rows = [row for log in logs for row in _rows(log)]
    text, whole, real, flag = pl.String, pl.Int64, pl.Float64, pl.Boolean
    kinds = {
        **dict(zip(IDENTITY, (text, text, text, whole, whole, whole, text), strict=True)),
        **{"target": whole, "kind": text, "cylinder": flag, "skill": text, "forced": flag},
        **dict.fromkeys(("release_height", "release_offset", "tilt", "object_speed", "gripper_speed"), real),
        "base_speed": real,
        **dict.fromkeys(("in_goal_release", "in_goal_skill_end", "in_goal_end", "in_goal_settled"), flag),
        **{"stabilizing": flag, "displacement": real, "fall": real, "cause": text},
    }
    return pl.DataFrame(rows, schema=kinds)


def kind_table(placements: pl.DataFrame) -> pl.DataFrame:
    """Return placements by object kind: their number, how many did not stay, and the rate."""
    return _rates(placements, (*GROUP, "kind", "cylinder"))


def shape_table(placements: pl.DataFrame) -> pl.DataFrame:
    """Return placements of cylinders and of other objects (thesis, figure 2-5).

    Beside counts and rates, what share of all placements they are, and what share of those that did not stay: a share
    of failures alone would not say whether cylinders fail more often or are only placed more often.
    """
    import polars as pl

    table = _rates(placements, (*GROUP, "cylinder"))
    return table.with_columns(
        of_placements=pl.col("placements") / pl.col("placements").sum().over(GROUP),
        of_failures=_share(pl.col("failures"), pl.col("failures").sum().over(GROUP)),
    )


def _rates(placements: pl.DataFrame, keys: tuple[str, ...]) -> pl.DataFrame:
    import polars as pl

    counted = placements.group_by(keys).agg(
        placements=pl.len().cast(pl.Int64), failures=(~pl.col("stabilizing")).sum().cast(pl.Int64)
    )
    return counted.with_columns(rate=pl.col("failures") / pl.col("placements")).sort(keys)


def _share(part: pl.Expr, whole: pl.Expr) -> pl.Expr:
    """Return a share, null where the whole is empty."""
    import polars as pl

    return pl.when(whole > 0).then(part / whole)


def _rows(log: EpisodeLog) -> list[dict[str, object]]:
    stays = stabilizing(log)
    return [
        {**{name: getattr(log, name) for name in IDENTITY}, **row}
        for target in range(len(log.targets))
        if (row := _row(log, target, stays[target])) is not None
    ]


def _row(log: EpisodeLog, target: int, stays: bool) -> dict[str, object] | None:
    release, span = placement(log, target), handled(log, target)
    if release is None or span is None:
        return None
    run = next((r for r in log.runs if r.begin <= release.step < r.end), None)
    away, above = release_offset(log, release)
    way = release.track.position[-1] - release.track.position[0]
    return {
        "target": target,
        "kind": log.targets[target].kind,
        "cylinder": log.targets[target].cylinder,
        "skill": "" if run is None else run.skill,
        "forced": run is not None and run.forced_release and release.step == run.end - 1,
        "release_height": above,
        "release_offset": away,
        "tilt": float(tilt(release.track.up[0])),
        "object_speed": release.object_speed,
        "gripper_speed": release.gripper_speed,
        "base_speed": release.base_speed,
        "in_goal_release": bool(in_goal_since(log, release)[0]),
        "in_goal_skill_end": log.at(span[1] - 1).in_goal[target],
        "in_goal_end": log.at(log.steps - 1).in_goal[target],
        "in_goal_settled": log.at(log.length - 1).in_goal[target],
        "stabilizing": stays,
        "displacement": float(np.hypot(way[0], way[1])),
        "fall": float(-way[2]),
        "cause": STAYED if stays else placement_cause(log, target),
    }
