"""What an evaluation comes back with."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import polars as pl


@dataclass(frozen=True, eq=False)
class ExtrapolationResult:
    """The table of all lanes, and where it was written."""

    frame: pl.DataFrame
    """One row for each lane and checkpoint; columns as in ``perdure.report.schema``."""
    path: Path
    """The Parquet file."""

    def final(self) -> pl.DataFrame:
        """One row for each lane: where it stood at the last checkpoint."""
        import polars as pl

        return self.frame.filter(pl.col("step") == pl.col("test_horizon"))

    def summary(self) -> pl.DataFrame:
        """One row for each policy and clock: lanes, mean return, share alive, median end step, share ever stuck."""
        import polars as pl

        return (
            self.final()
            .group_by("task", "policy", "clock", maintain_order=True)
            .agg(
                lanes=pl.len(),
                mean_return=pl.col("return").mean(),
                alive_share=pl.col("alive").mean(),
                median_end_step=pl.col("end_step").median(),
                stuck_share=(pl.col("stuck_steps") > 0).mean(),
                first_tenth=pl.col("first_tenth").mean(),
                last_tenth=pl.col("last_tenth").mean(),
            )
        )
