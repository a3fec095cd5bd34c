"""Work of an episode: what it earned above an idle robot, as a share of what a reference would have earned to the end.

    work = (return - idle rate x steps until the end) / ((reference rate - idle rate) x steps of the full episode)

1: the reference, to the end. 0: an idle robot, or an episode that ended at once. A robot that falls at half time and
worked as well as the reference until then has done half of the work.

| column | reference |
|---|---|
| `work_vs_calm` | the policy itself when calm (`calm_rate`) |
| `work_vs_published` | a published policy of the task (`published_rate`) |

Where the reference earns just what an idle robot earns, the task pays for survival alone: work is then the share of the
steps that the episode lasted. Where it earns less, work is nan. `work_vs_calm` is nan for a policy that never worked.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import polars as pl
from numpy.typing import ArrayLike, NDArray

from perdure.disturbances import CALM
from perdure.report.outcomes import WORKED, Holds

Curve = tuple[NDArray[np.int64], NDArray[np.float64]]
"""Recorded steps of an episode, and the sum of rewards up to each."""
SAME = 1e-9
"""Rates that differ by a smaller share are equal."""
WORK = ("calm_rate", "work_vs_calm", "work_vs_published")
"""The columns of `with_work`."""
_POLICY = ("task", "policy", "train_seed", "clock")


def episode_work(
    earned: ArrayLike, end_step: ArrayLike, steps: ArrayLike, idle_rate: ArrayLike, reference_rate: ArrayLike
) -> NDArray[np.float64]:
    """Return the work of episodes; all arguments broadcast.

    Args:
        earned: Sum of rewards until the episode ended.
        end_step: Steps that it lasted.
        steps: Steps of the full episode.
        idle_rate: Reward per step of an idle robot.
        reference_rate: Reward per step of the reference; nan where it is unknown.
    """
    idle = np.asarray(idle_rate, np.float64)
    reference = np.asarray(reference_rate, np.float64)
    lasted = np.asarray(end_step, np.float64)
    full = np.asarray(steps, np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        work = (np.asarray(earned, np.float64) - idle * lasted) / ((reference - idle) * full)
    same = np.isclose(reference, idle, rtol=SAME, atol=0.0)
    work = np.where(same, lasted / full, work)
    return np.where(same | (reference > idle), work, np.nan)


def with_work(facts: pl.DataFrame, curves: Sequence[Curve]) -> pl.DataFrame:
    """Return the episodes with the columns `WORK`.

    The calm rate of a policy under a clock is the mean, over its calm episodes that hold, of the reward per step after
    settling. Where there is none, or where survival is judged, it is the policy's rate within its training horizon.

    Args:
        facts: One row for each episode of an evaluation, calm and disturbed ones together, with all other columns.
        curves: Of each episode.
    """
    settling = facts["settling"].to_list()
    rates = [_rate_after(*curve, start) for curve, start in zip(curves, settling, strict=True)]
    worked = pl.col("policy_state") == WORKED
    gains = pl.col("training_rate") > pl.col("idle_rate")
    steady = (pl.col("disturbance") == CALM) & (pl.col("outcome") == Holds.name) & worked & gains
    facts = facts.with_columns(calm_rate=pl.Series(rates, dtype=pl.Float64))
    own = pl.when(steady).then("calm_rate").mean().over(_POLICY)
    facts = facts.with_columns(calm_rate=own.fill_null(pl.col("training_rate")))
    earned = [float(returns[-1]) for _, returns in curves]
    lasted = facts["end_step"].to_numpy()
    full = facts["test_horizon"].to_numpy()
    idle = facts["idle_rate"].to_numpy()
    calm = episode_work(earned, lasted, full, idle, facts["calm_rate"].to_numpy())
    published = episode_work(earned, lasted, full, idle, facts["published_rate"].to_numpy())
    calm[(facts["policy_state"] != WORKED).to_numpy()] = np.nan
    return facts.with_columns(work_vs_calm=pl.Series(calm), work_vs_published=pl.Series(published))


def _rate_after(steps: NDArray[np.int64], returns: NDArray[np.float64], settling: int) -> float:
    """Return the reward per step of an episode after settling, or of all of it where nothing is recorded after that."""
    begin = int(np.searchsorted(steps, settling))
    if settling == 0 or begin >= len(steps) - 1:
        return float(returns[-1] / steps[-1])
    return float((returns[-1] - returns[begin]) / (steps[-1] - steps[begin]))
