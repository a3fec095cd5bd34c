"""Groups: the lanes of a table that share task, policy and clock. A curve, a row or a dot shows one group."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import polars as pl
from numpy.typing import NDArray

from perdure.report import wording
from perdure.report.lanes import Lanes
from perdure.report.schema import table_lanes

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

NO_CLOCK = "none"
ROUNDING = 1e-9
"""Shares that differ by less are equal."""
LANE_FAILURES = ("falls", "fails silently", "decays", "diverges")
_KIND_ORDER = (NO_CLOCK, "countdown", "constant", "periodic")


@dataclass(frozen=True)
class Group:
    """Lanes that share task, line and clock."""

    task: str
    line: str
    """Name of the policies: the method, its training seeds pooled; the policy's label if that would mix policies."""
    clock: str
    clock_kind: str
    clock_steps: float
    train_horizon: float
    """[steps]; inf: trained without an end; nan: unknown."""
    test_horizon: int
    steps: IntArray
    """Recorded steps, shape (steps,), rising."""
    runs: IntArray
    """Which training run each lane belongs to, shape (lanes,)."""
    train_seeds: IntArray
    """Training seed of each lane's policy, shape (lanes,)."""
    keys: tuple[tuple[str, int, int], ...]
    """Policy, training seed and evaluation seed of each lane: what lanes under two clocks have in common."""
    returns: FloatArray
    """Shape (lanes, steps)."""
    alive: BoolArray
    """Shape (lanes, steps)."""
    end_details: tuple[str, ...]
    verdicts: tuple[str, ...]
    """Outcome of each lane; "never worked" or "cannot tell" if its policy was that within its training horizon."""
    notes: tuple[str, ...]
    """Why each lane has no outcome: the evidence for the state of its policy, or what cut it short; else ""."""
    failed_steps: IntArray
    """Steps before the lane's failure; without a failure, all steps of the lane, shape (lanes,)."""
    end_hold: FloatArray
    """Hold score at the end or before the lane ended, shape (lanes,); nan where it is not known."""
    ever_idle: BoolArray
    """Whether the lane was ever no better than idle for a while, shape (lanes,)."""
    movement_first: FloatArray
    """Movement per step in the first tenth of the steps, in training standard deviations, shape (lanes,)."""
    movement_last: FloatArray
    """Likewise in the last tenth; nan for lanes that ended before."""
    level: FloatArray
    """Level of each lane's policy within its training horizon, shape (lanes,); nan: no level is known."""
    only_survival: bool
    """Every step pays the same, to an idle robot too: there is no gain, only how long an episode lasts."""

    @property
    def lanes(self) -> int:
        """Number of lanes."""
        return len(self.runs)

    @property
    def label(self) -> str:
        """Label for readers, e.g. "geometric, always 500 steps to go"."""
        return self.line if self.clock_kind == NO_CLOCK else f"{self.line}, {self.clock_words}"

    @property
    def clock_words(self) -> str:
        """The clock for readers, e.g. "always 500 steps to go"."""
        known = np.isfinite(self.clock_steps)
        return wording.clock(self.clock_kind, wording.whole(self.clock_steps)) if known else self.clock

    @property
    def is_tuned_by_steps(self) -> bool:
        """Whether the clock has a parameter C."""
        return self.clock_kind in ("constant", "periodic")

    @cached_property
    def failed(self) -> BoolArray:
        """Which lanes fell, diverged, decayed or failed silently, shape (lanes,)."""
        return np.array([verdict in LANE_FAILURES for verdict in self.verdicts])

    @cached_property
    def working(self) -> FloatArray:
        """Share of lanes without a failure so far at each recorded step, by Kaplan and Meier (1958), shape (steps,).

        A lane that the environment cut, or that cannot be judged, is watched until it ended. Policies that never worked
        have failed from the start.
        """
        times, shares = self._kaplan_meier
        return np.concatenate([[1.0], shares])[np.searchsorted(times, self.steps, side="right")]

    @property
    def half_failed_by(self) -> float:
        """Steps by which half of the lanes have failed, see `half_failed_by`."""
        return half_failed_by(self.verdicts, self.failed_steps)

    @cached_property
    def _kaplan_meier(self) -> tuple[IntArray, FloatArray]:
        return kaplan_meier(self.verdicts, self.failed_steps)

    @cached_property
    def final_hold(self) -> FloatArray:
        """Hold score at the end; 0 for lanes that ended, nan where it is not known; shape (lanes,).

        A lane that fell before its first whole window counts as 0.
        """
        ended = ~self.alive[:, -1]
        return np.where(ended & (self.failed | np.isfinite(self.end_hold)), 0.0, self.end_hold)


def kaplan_meier(verdicts: Sequence[str], failed_steps: IntArray) -> tuple[IntArray, FloatArray]:
    """Return times of failure, rising, and the share of lanes without a failure after each [Kaplan and Meier, 1958].

    Args:
        verdicts: As `Group.verdicts`; "never worked" is a failure from the start.
        failed_steps: As `Group.failed_steps`.
    """
    never = np.array([verdict == "never worked" for verdict in verdicts])
    times = np.where(never, 0, failed_steps)
    event = np.isin(verdicts, LANE_FAILURES) | never
    at: IntArray = np.unique(times[event]).astype(np.int64)
    watched = len(times) - np.searchsorted(np.sort(times), at, side="left")
    failures = np.unique(times[event], return_counts=True)[1]
    shares: FloatArray = np.cumprod(1.0 - failures / watched, dtype=np.float64)
    return at, shares


def half_failed_by(verdicts: Sequence[str], failed_steps: IntArray) -> float:
    """Return the median of the Kaplan-Meier curve [steps]; nan where less than half of the lanes failed."""
    times, shares = kaplan_meier(verdicts, failed_steps)
    by_then = times[shares <= 0.5 + ROUNDING]
    return float(by_then[0]) if by_then.size else float("nan")


def make_groups(table: pl.DataFrame | Sequence[Lanes]) -> tuple[Group, ...]:
    """Split an extrapolation table, or its lanes, into groups.

    Tasks and lines keep the order in which the table names them; within a line the clocks are sorted: none, countdown,
    constant, periodic, each by its number of steps.

    Raises:
        ReportError: The frame does not fit the schema.
    """
    tasks = table_lanes(table, "The table") if isinstance(table, pl.DataFrame) else table
    groups = []
    for lanes in tasks:
        facts = _name_lines(lanes.facts.with_row_index("row")).sort("policy", "train_seed", "eval_seed")
        order = {line: index for index, line in enumerate(facts.sort("place")["line"].unique(maintain_order=True))}
        mine = [_make_group(lanes, part) for part in facts.partition_by("line", "clock")]
        groups += sorted(mine, key=lambda group: (order[group.line], *_clock_order(group)))
    return tuple(groups)


def tasks_of(groups: tuple[Group, ...]) -> tuple[str, ...]:
    """Return the tasks of the groups, each once, in order."""
    return tuple(dict.fromkeys(group.task for group in groups))


def _name_lines(facts: pl.DataFrame) -> pl.DataFrame:
    """Add the column `line`."""
    pooled = pl.col("policy").n_unique().over("method", "train_horizon") == 1
    ambiguous = pl.col("train_horizon").n_unique().over("method") > 1
    method = pl.col("method") + pl.when(ambiguous).then(pl.format(" (T = {})", _horizon_text())).otherwise(pl.lit(""))
    return facts.with_columns(line=pl.when(pooled).then(method).otherwise("policy"))


def _horizon_text() -> pl.Expr:
    horizon = pl.col("train_horizon")
    whole = horizon.is_finite()
    number = pl.when(whole).then(horizon).otherwise(0.0).cast(pl.Int64).cast(pl.String)
    return pl.when(whole).then(number).when(horizon.is_nan()).then(pl.lit("?")).otherwise(pl.lit("\u221e"))


def _clock_order(group: Group) -> tuple[int, str, float, str]:
    kind = group.clock_kind
    place = _KIND_ORDER.index(kind) if kind in _KIND_ORDER else len(_KIND_ORDER)
    return place, kind, np.nan_to_num(group.clock_steps, nan=-1.0), group.clock


def _make_group(lanes: Lanes, part: pl.DataFrame) -> Group:
    head, rows = part.row(0, named=True), part["row"].to_numpy()
    return Group(
        **{name: head[name] for name in ("task", "line", "clock", "clock_kind", "clock_steps")},
        train_horizon=head["train_horizon"],
        test_horizon=head["test_horizon"],
        steps=lanes.steps,
        runs=part.select(pl.struct("policy", "train_seed").rank("dense")).to_series().cast(pl.Int64).to_numpy(),
        train_seeds=part["train_seed"].to_numpy(),
        keys=tuple(part.select("policy", "train_seed", "eval_seed").iter_rows()),
        returns=lanes.returns[rows],
        alive=lanes.alive[rows],
        end_details=tuple(part["end_detail"]),
        verdicts=tuple(part.select(VERDICT).to_series()),
        notes=tuple(part.select(_NOTE).to_series()),
        failed_steps=part["failed_step"].to_numpy(),
        end_hold=part["end_hold"].to_numpy(),
        ever_idle=part["ever_idle"].to_numpy(),
        movement_first=part["movement_first"].to_numpy(),
        movement_last=part["movement_last"].to_numpy(),
        level=part.select(_level(pl.col("reference_rate"))).to_series().to_numpy(),
        only_survival=bool((part["reference_rate"] == part["idle_rate"]).all()),
    )


def _level(rate: pl.Expr) -> pl.Expr:
    return (rate - pl.col("idle_rate")) / (pl.col("level_rate") - pl.col("idle_rate"))


VERDICT = (
    pl.when(pl.col("policy_state") != "worked")
    .then(pl.col("policy_state"))
    .when(pl.col("outcome").is_in(["cut", "unknown"]))
    .then(pl.lit("cannot tell"))
    .otherwise(pl.col("outcome"))
)
"""Outcome of a lane as reports show it, from the columns of a table."""
_NOTE = (
    pl.when(pl.col("policy_state") != "worked")
    .then(pl.col("policy_note"))
    .when(pl.col("outcome") == "cut")
    .then(pl.lit("the environment ended the episodes, for a reason that is no failure"))
    .when(pl.col("outcome") == "unknown")
    .then(pl.lit("too few steps, or a final score too close to 75 % to tell"))
    .otherwise(pl.lit(""))
)
