"""Verdicts of all committed policies, before and after a change of the rules.

Run it from the root of a clone: ``python -m studies.disturbance.verdicts``.

The committed tables hold an episode's final score and the rate of its policy within training, by the rules of their
day. The policy files hold the reference episodes. The rate is computed from them again by the rules of this version,
and the final scores follow: score x (old rate - idle) / (new rate - idle). An episode that held still does if its new
score is at least `holds_from`, or as large as before. Nothing is simulated.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import polars as pl

from perdure.evaluate.reference import Idle
from perdure.evaluate.verdict import ScoreScale, make_score_scale, published_rate
from perdure.policy import load_policy
from perdure.report.caveats import CALM_WORK
from perdure.report.estimates import HOLDING_SHARE
from perdure.report.outcomes import WORKED, Holds
from perdure.report.scores import holds_from
from perdure.report.work import episode_work
from studies.disturbance.tables import foresight_table

RESULTS = Path("results")
POLICIES = RESULTS / "horizon" / "policies"
DISTURBED = ("episodes.parquet", "registered.parquet", "pilots.parquet")
GROUP = ("task", "method", "train_seed", "clock", "condition")
"""Columns of a verdict: one training run under one clock and condition."""
RUN = ("task", "method", "train_seed", "clock")
ROUNDING = 1e-6
VERDICT = 0.75
"""Threshold of the row of the table of foresight that is the verdict's."""


@cache
def scale(task: str, method: str, train_seed: int, idle_rate: float) -> ScoreScale | None:
    """Return the score scale of a committed policy; None where its file is not committed."""
    path = POLICIES / task / method / f"seed-{train_seed}.safetensors"
    if not path.is_file():
        return None
    reference = load_policy(path).reference
    assert reference is not None
    return make_score_scale(reference, Idle(idle_rate, idle_rate), published_rate(task))


def committed() -> pl.DataFrame:
    """Return the final scores of all committed episodes, calm and disturbed: a row for each episode."""
    columns = [*GROUP, "outcome", "end_score_vs_training", "policy_state", "idle_rate", "training_rate"]
    columns += ["published_rate", "return", "end_step", "test_horizon", "end_reason", "failed_step"]
    horizon = pl.read_parquet(RESULTS / "horizon" / "episodes.parquet").filter(split="test")
    setting = pl.col("setting").str.split("@")
    preset = setting.list.get(1, null_on_oob=True)
    horizon = horizon.with_columns(
        task=setting.list.first(),
        method=pl.when(preset.is_null()).then("method").otherwise(pl.format("{}@{}", "method", preset)),
        condition=pl.lit("100,000 calm steps"),
    )
    parts = [horizon.select(columns)]
    parts += [pl.read_parquet(RESULTS / "disturbance" / name).select(columns) for name in DISTURBED]
    return pl.concat(parts)


def judged_again(episodes: pl.DataFrame) -> pl.DataFrame:
    """Return the episodes of committed policies with `new_score`, `new_rate`, `settling` and `new_holds`."""
    rows = []
    for row in episodes.iter_rows(named=True):
        found = scale(row["task"], row["method"], row["train_seed"], row["idle_rate"])
        if found is not None:
            rows.append(row | _new_columns(row, found))
    return pl.DataFrame(rows, infer_schema_length=None)


def _new_columns(row: Mapping[str, Any], found: ScoreScale) -> dict[str, Any]:
    old_gain = row["training_rate"] - row["idle_rate"]
    new_gain = found.training_rate - found.idle_rate
    score = row["end_score_vs_training"] * old_gain / new_gain
    held = row["policy_state"] == WORKED and row["outcome"] == Holds.name
    # A score of the last tenth below the bound held where an average over more windows did: it still does if unchanged.
    least = min(holds_from(found.way_score), row["end_score_vs_training"] - ROUNDING)
    holds = held and found.policy_state == WORKED and score >= least
    return {"new_score": score, "new_rate": found.training_rate, "settling": found.settling, "new_holds": holds}


def verdicts(episodes: pl.DataFrame) -> pl.DataFrame:
    """Return a row for each verdict: the shares of episodes that hold before and after, and work against calm."""
    held = (pl.col("policy_state") == WORKED) & (pl.col("outcome") == Holds.name)
    calm_rate = pl.col("idle_rate") + pl.col("end_score_vs_training") * (pl.col("training_rate") - pl.col("idle_rate"))
    calm = episodes.filter((pl.col("condition") == "calm") & held).group_by(RUN).agg(calm_rate=calm_rate.mean())
    episodes = episodes.join(calm, RUN, "left").with_columns(pl.col("calm_rate").fill_null(pl.col("new_rate")))
    numbers = [episodes[name].to_numpy() for name in ("return", "end_step", "test_horizon", "idle_rate", "calm_rate")]
    return (
        episodes.with_columns(held=held, work=pl.Series(episode_work(*numbers)))
        .group_by(GROUP)
        .agg(
            before=pl.col("held").mean(),
            after=pl.col("new_holds").mean(),
            score_before=pl.col("end_score_vs_training").mean(),
            score_after=pl.col("new_score").mean(),
            rate_before=pl.col("training_rate").first(),
            rate_after=pl.col("new_rate").first(),
            settling=pl.col("settling").first(),
            work=pl.col("work").mean(),
        )
        .sort(GROUP)
    )


def main() -> None:
    """Print the verdicts that change, those that hold with less than 0.75 of the calm work, and both AUC."""
    episodes = judged_again(committed())
    found = verdicts(episodes)
    holds = pl.col("before") >= HOLDING_SHARE
    still = pl.col("after") >= HOLDING_SHARE
    changed = found.filter(holds != still)
    print(f"{len(found)} verdicts of {episodes.select('task', 'method', 'train_seed').n_unique()} policies")
    print(f"{len(found.filter(holds))} held, {len(found.filter(still))} hold, {len(changed)} changed")
    disturbed = ~pl.col("condition").str.contains("calm")
    less = found.filter(still & disturbed & (pl.col("work") < CALM_WORK))
    print(f"{len(found.filter(still & disturbed))} of them are disturbed; {len(less)} work less than when calm")
    print("\n| policy | condition | episodes that hold | final score | rate in training | left out |")
    print("|---|---|---|---|---|---|")
    print("\n".join(_lines(changed)))
    print("\n| condition | verdict | AUC before | AUC after |\n|---|---|---|---|")
    print("\n".join(_foresight()))


def _lines(changed: pl.DataFrame) -> Iterator[str]:
    """Yield a row of Markdown for each verdict that changes."""
    for row in changed.iter_rows(named=True):
        who = f"{row['task']}/{row['method']}/seed-{row['train_seed']}, {row['clock']}"
        shares = f"{row['before']:.0%} → {row['after']:.0%}"
        scores = f"{row['score_before']:.2f} → {row['score_after']:.2f}"
        rates = f"{row['rate_before']:.2f} → {row['rate_after']:.2f}"
        yield f"| {who} | {row['condition']} | {shares} | {scores} | {rates} | {row['settling']} steps |"


def _foresight() -> Iterator[str]:
    """Yield a row of Markdown for each AUC of the verdict, with the scores before and after."""
    episodes = pl.read_parquet(RESULTS / "disturbance" / DISTURBED[0]).with_columns(
        preset=pl.col("method").str.split("@").list.get(1, null_on_oob=True).fill_null("zoo"),
        left=pl.col("end_reason") == "survived",
    )
    again = judged_again(episodes)
    known = again.select(episodes.columns)
    before = foresight_table(known).filter(threshold=VERDICT)
    after = foresight_table(again.with_columns(end_score_vs_training="new_score")).filter(threshold=VERDICT)
    for old, new in zip(before.iter_rows(named=True), after.iter_rows(named=True), strict=True):
        if not math.isnan(old["AUC"]):
            yield f"| {old['new condition']} | {old['verdict']} | {old['AUC']:.4f} | {new['AUC']:.4f} |"


if __name__ == "__main__":
    main()
