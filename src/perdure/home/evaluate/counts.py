"""Success as a person means it: four counts of an episode, from its log and its start.

- *stays*: every stage is reached and every placement is goal-stabilizing (`outcomes.stages_stabilizing`).
- *upright*: every target stands at the end as a person would put it (`Kind.axis`, `TILTED`).
- *undisturbed*: no other object tipped, fell on the floor or moved by more than `DISTURBED`, from start to end.
- *soft*: no contact force of `SOFT_FORCE` or more at arm, hand or held object, the base left out.

A log has one force for each skill, so it cannot tell the handle in use from anything else that the hand meets while it
opens or closes a door or drawer. These skills have the limit `HANDLE_FORCE` instead, for all contacts. Logs have no
force of the settling time, in which the robot stands still.

An episode in which the simulation diverged has none of the four counts. A count is None where the log does not tell:
final poses or forces are missing, or the start is no episode of this package.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from perdure.errors import PerdureError
from perdure.home.evaluate import outcomes
from perdure.home.evaluate.analysis import GROUP, episode_means, group_of
from perdure.home.evaluate.log import EpisodeLog, FinalObject
from perdure.home.sim.arrays import Quaternion
from perdure.home.sim.objects import KINDS, Placement
from perdure.home.tasks.episodes import Episode, episode_hash, load_episodes
from perdure.home.tasks.tasks import SKILL_CONTAINERS
from perdure.stats import survival_interval

if TYPE_CHECKING:
    import polars as pl

TILTED = 45.0
"""An object whose axis is so many degrees from the vertical, or more, is not upright."""
DISTURBED = 0.05
"""An object that is farther than this in [m] from where it started is disturbed."""
SOFT_FORCE = 500.0
"""Contact force in [N] from which on a skill is not soft."""
HANDLE_FORCE = 1000.0
"""The same for skills that open or close a container, our choice: the hand meets the fridge's handle with 900 N."""
COUNTS = ("stays", "upright", "undisturbed", "soft", "all_four")


@dataclass(frozen=True)
class FourCounts:
    """The four counts of an episode; None where its log does not tell."""

    stays: bool
    upright: bool | None
    undisturbed: bool | None
    soft: bool | None

    @property
    def all_four(self) -> bool | None:
        """Whether all four hold: False as soon as one does not, None when none is False and one is unknown."""
        every = (self.stays, self.upright, self.undisturbed, self.soft)
        if False in every:
            return False
        return None if None in every else True


def four_counts(log: EpisodeLog, start: Episode | None = None) -> FourCounts:
    """Return the four counts of an episode.

    Args:
        log: Its log.
        start: The episode; None: the published one that the log belongs to, if there is one.
    """
    if log.diverged:
        return FourCounts(stays=False, upright=False, undisturbed=False, soft=False)
    return FourCounts(
        stays=outcomes.stages_stabilizing(log)[-1],
        upright=_targets_upright(log),
        undisturbed=_others_undisturbed(log, start or known_start(log)),
        soft=_soft(log),
    )


def axis_tilt(kind: str, quaternion: Quaternion) -> float | None:
    """Return the angle in [deg] between an object's axis and the vertical: 0 where any attitude is as good.

    None for a kind that this package does not know.
    """
    if kind not in KINDS:
        return None
    axis = KINDS[kind].axis
    if axis == "none":
        return 0.0
    _, qx, qy, _ = quaternion
    up = 1.0 - 2.0 * (qx * qx + qy * qy)
    if axis == "either z":
        up = abs(up)
    return math.degrees(math.acos(min(1.0, max(-1.0, up))))


def _targets_upright(log: EpisodeLog) -> bool | None:
    if not log.final_objects:
        return None
    tilts = [axis_tilt(each.kind, each.quaternion) for each in log.final_objects[: len(log.targets)]]
    if any(tilt is not None and tilt >= TILTED for tilt in tilts):
        return False
    return None if None in tilts else True


def _others_undisturbed(log: EpisodeLog, start: Episode | None) -> bool | None:
    if start is None or len(log.final_objects) != len(start.objects):
        return None
    first = len(log.targets)
    pairs = zip(start.objects[first:], log.final_objects[first:], strict=True)
    return not any(is_disturbed(before, after) for before, after in pairs)


def known_start(log: EpisodeLog) -> Episode | None:
    """Return the episode that a log belongs to, None where this package has no such episode."""
    try:
        episode = load_episodes(log.task, log.split)[log.index]
    except PerdureError:  # another simulator's split, or an episode beyond the last one
        return None
    return episode if episode_hash(episode) == log.episode_hash else None


def is_disturbed(before: Placement, after: FinalObject) -> bool:
    """Return whether an object moved or tipped. What fell on the floor has moved by the height of its furniture."""
    if math.dist(before.position, after.position) > DISTURBED:
        return True
    at_start = axis_tilt(before.kind, before.quaternion)
    at_end = axis_tilt(after.kind, after.quaternion)
    return at_start is not None and at_end is not None and at_start < TILTED <= at_end


def _soft(log: EpisodeLog) -> bool | None:
    unknown = False
    for run in log.runs:
        limit = HANDLE_FORCE if run.skill in SKILL_CONTAINERS else SOFT_FORCE
        if math.isnan(run.force):
            unknown = True
        elif run.force >= limit:
            return False
    return None if unknown else True


def counts_table(logs: Sequence[EpisodeLog], seed: int = 0) -> pl.DataFrame:
    """Return the share of each count, one row per group of `analysis.GROUP`.

    Columns: `train_seeds`, `eval_seeds` and `episodes` that were counted; `taken_over`: episodes in which the oracle
    took over at least one skill; mean and bounds of the 95 % interval of each of `COUNTS` (`stays mean`), null where a
    log does not tell; `method` of the intervals, as in `analysis.stage_table`.

    Args:
        logs: The episodes.
        seed: Of the bootstrap.
    """
    import polars as pl

    groups: dict[tuple[str, ...], list[EpisodeLog]] = {}
    for log in sorted(logs, key=lambda log: log.key):
        groups.setdefault(group_of(log), []).append(log)
    rows = []
    for group, part in groups.items():
        named = dict(zip(GROUP, group, strict=True))
        rows.append({**named, **_shares(part, np.random.default_rng(seed))})
    return pl.DataFrame(rows, infer_schema_length=None)


def _shares(logs: Sequence[EpisodeLog], rng: np.random.Generator) -> dict[str, Any]:
    """Return the columns of `counts_table` of the logs of one group."""
    row: dict[str, Any] = {
        "train_seeds": len({log.train_seed for log in logs}),
        "eval_seeds": len({log.eval_seed for log in logs}),
        "episodes": len(logs),
        "taken_over": sum(any(run.scripted for run in log.runs) for log in logs),
    }
    counted = [four_counts(log) for log in logs]
    for name in COUNTS:
        values = [getattr(each, name) for each in counted]
        if None in values:
            row |= {f"{name} mean": None, f"{name} lower": None, f"{name} upper": None}
            continue
        means, train_seeds = episode_means(np.array(values, dtype=np.float64), logs)
        found = survival_interval(means, train_seeds, rng)
        row[f"{name} mean"] = float(found.estimate)
        row[f"{name} lower"] = float(found.lower)
        row[f"{name} upper"] = float(found.upper)
        row["method"] = found.method  # the same for all: stays is always known
    return row
