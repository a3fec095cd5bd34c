"""The table ``perdure.extrapolation`` of an evaluation (columns: ``perdure.report.schema``), and the result around it.

`episode_table` makes the raw columns of the table; `perdure.evaluate.judge` adds the columns that are judged.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from perdure.evaluate.episodes import SURVIVED, EpisodeRecords, EpisodeSpec
from perdure.evaluate.judge import Baselines, write_baselines
from perdure.evaluate.options import Condition
from perdure.horizon import usual_preset
from perdure.policy import PolicyLike
from perdure.report.outcomes import outcome_words
from perdure.report.schema import END_REASONS, FILE_NOTE, GOALS, STOPPED_NOTE, EarlyStop
from perdure.runs import versions

if TYPE_CHECKING:
    import polars as pl

TABLE_FILE = "episodes.parquet"
"""Name of the table's file."""


def file_note(policy: str, train_seed: int) -> str:
    """Return the name of the note with the SHA-256 of the file of a policy of a table."""
    return f"{FILE_NOTE}{policy}, training seed {train_seed}"


@dataclass(frozen=True, eq=False)
class ExtrapolationResult:
    """The table of all episodes, and where it was written. As text: the verdicts and the summary table."""

    frame: pl.DataFrame
    """One row for each episode and recorded step; columns as in ``perdure.report.schema``."""
    path: Path | None
    """The Parquet file; None where nothing was written."""
    files: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of each policy file by `file_note`: stored with the table, so that a card can check its policy."""
    baselines: Baselines = field(default_factory=dict)
    """What the rewards of each policy are compared with: stored beside the table, which can then be judged again."""
    success: str = ""
    """The `success` of the evaluation; "": the environment's own entry."""
    stopped: EarlyStop | None = None
    """How the evaluation ended before all of its episodes; None if it did not."""

    def __str__(self) -> str:
        from perdure.report import summary_text

        text = summary_text(self.frame)
        return text if self.stopped is None else f"{text}\n\nThe evaluation {self.stopped}."

    def write(self, out: str | Path, command: str = "") -> Path:
        """Write the table and its report into a folder; return the page.

        Args:
            out: A folder; made if it is missing.
            command: What made the table, for a reader who wants to repeat it.
        """
        from perdure.report import estimate_table, write_report
        from perdure.report.summary import write_summary

        table, notes = self.write_table(out, command)
        estimates = estimate_table(self.frame)
        page = write_report(estimates, out, command, notes=notes)
        write_summary(estimates, table, page, notes)
        return page

    def write_table(self, out: str | Path, command: str) -> tuple[Path, dict[str, str]]:
        """Write the table and its baselines into a folder; return its file and its notes. Arguments as of `write`."""
        from perdure.report import write_table

        notes = {"command": command, "success": self.success, **made_with(), **self.files}
        if self.stopped is not None:
            notes[STOPPED_NOTE] = msgspec.json.encode(self.stopped).decode()
        if self.baselines:
            notes |= write_baselines(Path(out), self.baselines)
        return write_table(Path(out) / TABLE_FILE, self.frame, notes), notes

    @property
    def holds(self) -> bool:
        """Whether all policies hold, or reach their goal, under every clock and disturbance."""
        from perdure.report.estimates import estimate_table
        from perdure.report.summary import not_holding

        return not not_holding(estimate_table(self.frame))

    @property
    def clean(self) -> bool:
        """Whether all policies hold, or reach their goal, without a caveat (`perdure.report.caveats`)."""
        from perdure.report.estimates import estimate_table
        from perdure.report.summary import not_clean

        return not not_clean(estimate_table(self.frame))

    @cached_property
    def final(self) -> pl.DataFrame:
        """One row for each episode: its values at the last recorded step."""
        import polars as pl

        return self.frame.filter(pl.col("step") == pl.col("test_horizon"))

    @cached_property
    def summary(self) -> pl.DataFrame:
        """One row for each policy, clock and disturbance: episodes, returns, shares of outcomes, failures.

        The median is that of the Kaplan-Meier curve; null where less than half of the episodes failed. `policy_state`
        names every state of the policies in the row, such as "never worked, worked".
        """
        import polars as pl

        from perdure.report.groups import episode_verdicts, half_failed_by

        shown = outcome_words(in_table=True, shown_as="")
        keys = ["task", "policy", "clock", "disturbance"]
        episodes = self.final.with_columns(verdict=episode_verdicts())
        medians = [
            half_failed_by(part["verdict"].to_list(), part["failed_step"].to_numpy())
            for part in episodes.partition_by(keys, maintain_order=True)
        ]
        return (
            episodes.group_by(keys, maintain_order=True)
            .agg(
                episodes=pl.len(),
                mean_return=pl.col("return").mean(),
                policy_state=pl.col("policy_state").unique().sort().str.join(", "),
                **{word.replace(" ", "_"): (pl.col("outcome") == word).mean() for word in shown},
            )
            .with_columns(median_failed_step=pl.Series(medians, dtype=pl.Float64).fill_nan(None))
        )


def made_with() -> dict[str, str]:
    """Return the notes of a table on the day and the versions it was made with."""
    found = versions("envpool", "gymnasium", "mujoco", "numpy")
    return {"evaluated": date.today().isoformat(), "versions": ", ".join(f"{name} {at}" for name, at in found.items())}


def method_label(policy: PolicyLike, default: str) -> str:
    """Return how tables call a policy: its method, and its preset if that is not the usual one of the task."""
    known = policy.provenance
    method = str(known.get("method", default))
    preset = known.get("preset")
    config = known.get("config")
    if preset is None and isinstance(config, Mapping) and "algorithm" not in config:
        preset = "zoo"  # the preset of PPO that policy files do not name
    if preset in (None, usual_preset(policy.task.name)):
        return method
    return f"{method} ({preset})"


def train_seed(policy: PolicyLike) -> int:
    """Return the training seed of a policy as tables have it; 0 where it is unknown."""
    return int(policy.provenance.get("seed", 0))


def episode_table(
    labels: Sequence[str], policies: Sequence[PolicyLike], episodes: Sequence[EpisodeSpec], records: EpisodeRecords
) -> pl.DataFrame:
    """Return one row for each episode and recorded step; `labels` name the policies that episodes point into."""
    import polars as pl

    n, m = records.returns.shape
    rows = [_episode_row(labels[episode.policy], policies[episode.policy], episode) for episode in episodes]
    reached = records.steps[None, :] <= records.end_step[:, None]
    survived = (records.end_reason == SURVIVED)[:, None]
    columns: dict[str, object] = {name: [row[name] for row in rows for _ in range(m)] for name in rows[0]}
    columns |= {
        "step_seconds": np.full(n * m, records.step_seconds),
        "step": np.tile(records.steps, n),
        "return": records.returns.ravel(),
        # An episode that ended with step s has completed s - 1 steps without ending.
        "alive": (reached & (survived | (records.steps[None, :] < records.end_step[:, None]))).ravel(),
        "end_reason": [END_REASONS[reason] for reason in records.end_reason for _ in range(m)],
        "end_step": np.repeat(records.end_step, m),
        "end_detail": [detail for detail in records.end_detail for _ in range(m)],
        "movement_first": np.repeat(records.movement[0], m),
        "movement_last": np.repeat(records.movement[1], m),
        **{name: np.repeat(found, m) for name, found in zip(GOALS, records.goals, strict=True)},
        **{name: np.repeat(found, m) for name, found in records.measures.items()},
    }
    return pl.DataFrame(columns)


def _episode_row(label: str, policy: PolicyLike, episode: EpisodeSpec) -> dict[str, object]:
    clock = episode.clock
    return {
        "policy": label,
        "method": str(policy.provenance.get("method", "unknown")),
        "task": policy.task.name,
        "train_seed": train_seed(policy),
        "train_horizon": float(policy.training_horizon),
        "clock": "none" if clock is None else clock.label,
        "clock_kind": "none" if clock is None else clock.name,
        "clock_steps": math.nan if clock is None else float(clock.steps),
        "eval_seed": episode.eval_seed,
        "disturbance": episode.disturbance,
        "test_horizon": episode.steps,
    }


def with_not_applied(frame: pl.DataFrame, conditions: Sequence[Condition]) -> pl.DataFrame:
    """Return a table with the column `not_applied`: what the world could not do of each episode's disturbances."""
    import polars as pl

    label = pl.col("disturbance")
    found = {each.label: each.not_applied for each in conditions}
    return frame.with_columns(not_applied=label.replace_strict(found, default="", return_dtype=pl.String))
