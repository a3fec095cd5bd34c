"""Figures 2-1 and 2-3: outcomes of the episodes, under the policy alone and with inverse kinematics."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from perdure.home.evaluate.page import words
from perdure.report import theme, wording
from perdure.report.axes import Axis
from perdure.report.render import Figure
from perdure.report.rows import Bars, bar_chart
from perdure.studies.placement.names import SPLITS, TITLES
from perdure.studies.placement.results import Results, Row, chosen, strategy_and_world

NUMBERS = {"rl": "2-1", "ik": "2-3"}
"""Release strategy to the number of its figure in the thesis."""


def outcome_figures(results: Results) -> Iterator[Figure]:
    """Yield a figure for each strategy and split, drag only."""
    for split in SPLITS:
        for strategy, number in NUMBERS.items():
            rows = [row for row in chosen(results.rows, split, "drag") if strategy_and_world(row)[0] == strategy]
            if rows:
                yield _figure(rows, split, strategy, f"figure-{number}-{split}")


def outcome_counts(row: Row) -> dict[str, int]:
    """Return how many episodes had each outcome, see `perdure.home.evaluate.outcomes`; they sum to all."""
    succeeded = row["episodes"] - row["failed"]
    other = row["failed"] - sum(row["failed_at"].values())
    return {
        "success": succeeded - row["did_not_last"],
        "success that did not last": row["did_not_last"],
        **row["failed_at"],
        "other": other,
    }


def _figure(rows: list[Row], split: str, strategy: str, name: str) -> Figure:
    names, shares, texts = [], [], []
    for row in rows:
        for outcome, count in outcome_counts(row).items():
            of_all = count / row["episodes"]
            failed = row["failed"] if outcome.startswith("place_") or outcome == "other" else 0
            names.append(f"{TITLES[row['task']]}: {words.outcome(outcome)}")
            shares.append(of_all)
            texts.append(
                f"{count} of {row['episodes']} ({wording.share(of_all)})"
                + (f", {wording.share(count / failed)} of the failed" if failed and count else "")
            )
    bars = [Bars(words.describe(strategy), range(len(names)), np.array(shares), texts, theme.style(0))]
    return Figure(
        name,
        f"What became of the episodes: {words.describe(strategy)}",
        bar_chart(names, bars, Axis("share of episodes", percent=True), theme.WIDE),
        f"Apartments with {SPLITS[split]}, drag only. Did not stay: the first placement that failed or "
        "did not last. Counted as success: by the benchmark.",
        wide=True,
    )
