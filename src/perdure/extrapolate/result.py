"""Result of an evaluation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import polars as pl

TABLE = "lanes.parquet"
"""Name of the table's file."""


FILE_NOTE = "sha256 of "
"""How the names of the notes begin that say which policy files a table is of."""


def file_note(policy: str, train_seed: int) -> str:
    """Return the name of the note with the SHA-256 of the file of a policy of a table."""
    return f"{FILE_NOTE}{policy}, training seed {train_seed}"


@dataclass(frozen=True, eq=False)
class ExtrapolationResult:
    """The table of all lanes, and where it was written. As text: the verdicts and the summary table."""

    frame: pl.DataFrame
    """One row for each lane and recorded step; columns as in ``perdure.report.schema``."""
    path: Path | None
    """The Parquet file; None where nothing was written."""
    files: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of each policy file by `file_note`: stored with the table, so that a card can check its policy."""

    def __str__(self) -> str:
        """Return the verdict on each policy and clock, and the summary table."""
        from perdure.report import summary_text

        return summary_text(self.frame)

    def write(self, out: str | Path, command: str = "") -> Path:
        """Write the table and its report into a folder; return the page.

        Args:
            out: A folder; made if it is missing.
            command: What made the table, for a reader who wants to repeat it.
        """
        from perdure.report import write_report, write_table

        Path(out).mkdir(parents=True, exist_ok=True)
        write_table(Path(out) / TABLE, self.frame, {"command": command, **self.files})
        return write_report(self.frame, out, command)

    def final(self) -> pl.DataFrame:
        """Return one row for each lane: its values at the last recorded step."""
        import polars as pl

        return self.frame.filter(pl.col("step") == pl.col("test_horizon"))

    def summary(self, by_training_run: bool = False) -> pl.DataFrame:
        """Return one row for each policy and clock: lanes, mean return, shares of outcomes, median time to failure.

        The median is that of the Kaplan-Meier curve; null where less than half of the lanes failed. `policy_state`
        names every state of the policies in the row, such as "never worked, worked".

        Args:
            by_training_run: One row for each training run instead of one for all runs of a method; adds `train_seed`.
        """
        import polars as pl

        from perdure.report.groups import VERDICT, half_failed_by

        outcomes = ("holds", "decays", "fails silently", "falls", "diverges")
        keys = ["task", "policy", *(["train_seed"] if by_training_run else []), "clock"]
        lanes = self.final().with_columns(verdict=VERDICT)
        medians = [
            half_failed_by(part["verdict"].to_list(), part["failed_step"].to_numpy())
            for part in lanes.partition_by(keys, maintain_order=True)
        ]
        return (
            lanes.group_by(keys, maintain_order=True)
            .agg(
                lanes=pl.len(),
                mean_return=pl.col("return").mean(),
                policy_state=pl.col("policy_state").unique().sort().str.join(", "),
                **{outcome.replace(" ", "_"): (pl.col("outcome") == outcome).mean() for outcome in outcomes},
            )
            .with_columns(median_failed_step=pl.Series(medians, dtype=pl.Float64).fill_nan(None))
        )
