"""Judging: the verdict columns of a table, computed from its raw columns and from the baselines of its policies.

A baseline is what the rewards of a policy are compared with: its reference episodes, and an idle robot. It is written
beside the table, so that other rules can judge stored episodes without a simulator (`read_judged`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from perdure.envs.suites import is_contract
from perdure.errors import PerdureError, warn
from perdure.evaluate.episodes import window_steps
from perdure.evaluate.reference import Idle
from perdure.evaluate.verdict import ScoreScale, judge_episode, make_score_scale, published_rate
from perdure.policy import Reference
from perdure.report.schema import COLUMNS, JUDGED, Episodes, read_episodes
from perdure.runs import file_digest, write_atomic
from perdure.schema import Parquet, checked, parquet_bytes

if TYPE_CHECKING:
    import polars as pl

BASELINES = "baselines.parquet"
"""Name of the file with the baselines of a table's policies, beside the table."""
NOTE = "baselines"
"""Name of the table's note with the SHA-256 of that file."""
PolicyKey = tuple[str, int]
"""Label and training seed of a policy of a table."""
Scales = Mapping[PolicyKey, ScoreScale]
Curve = tuple[NDArray[np.int64], NDArray[np.float64]]
"""Recorded steps of an episode, and the sum of rewards up to each."""


@dataclass(frozen=True, eq=False)
class Baseline:
    """What the rewards of a policy are compared with."""

    reference: Reference
    """The policy within its training horizon."""
    idle: Idle
    """An idle robot in the same task."""

    def scale(self, task: str) -> ScoreScale:
        """Return the score scale of the policy in a task, such as "Hopper-v3"."""
        return make_score_scale(self.reference, self.idle, published_rate(task), is_contract(task))


Baselines = Mapping[PolicyKey, Baseline]


def make_scales(baselines: Baselines, task: str) -> Scales:
    """Return the score scale of each policy in a task."""
    return {key: baseline.scale(task) for key, baseline in baselines.items()}


# Judging


def judge_table(frame: pl.DataFrame, scales: Scales) -> pl.DataFrame:
    """Return a table with the columns that are judged, `JUDGED`.

    Args:
        frame: Raw columns, as `episode_table` makes them, episode after episode; they may differ in disturbances and
            steps.
        scales: The score scale of each policy.
    """
    last = np.flatnonzero(frame["step"] == frame["test_horizon"])
    begins = np.concatenate([[0], last[:-1] + 1])
    grid = frame["step"].to_numpy()
    returns = frame["return"].to_numpy()
    curves = [(grid[begin:end], returns[begin:end]) for begin, end in zip(begins, last + 1, strict=True)]
    judged = _judge(frame[last], curves, scales)
    return frame.drop(JUDGED, strict=False).hstack(judged[np.repeat(np.arange(len(last)), last + 1 - begins)])


def judge_again(episodes: Episodes, scales: Scales) -> Episodes:
    """Return the episodes of a stored table with the columns that are judged computed anew."""
    curves = [(episodes.steps, returns) for returns in episodes.returns]
    return replace(episodes, facts=episodes.facts.with_columns(_judge(episodes.facts, curves, scales)))


def _judge(episodes: pl.DataFrame, curves: Iterable[Curve], scales: Scales) -> pl.DataFrame:
    """Return the judged columns of episodes, one row for each: of their raw columns and their curves."""
    import polars as pl

    rows = []
    for episode, (steps, returns) in zip(episodes.iter_rows(named=True), curves, strict=True):
        rows.append(_judged_row(episode, steps, returns, scales))
    return pl.DataFrame(rows, {name: COLUMNS[name] for name in JUDGED})


def _judged_row(
    episode: Mapping[str, Any], steps: NDArray[np.int64], returns: NDArray[np.float64], scales: Scales
) -> dict[str, Any]:
    """Return the judged columns of one episode.

    Args:
        episode: Its raw columns.
        steps: Recorded steps, shape (m,).
        returns: Sum of rewards up to each, shape (m,).
        scales: The score scale of each policy.
    """
    key = (episode["policy"], episode["train_seed"])
    if key not in scales:
        raise PerdureError(f"there is no baseline of the policy {key[0]!r}, training seed {key[1]}")
    scale = scales[key]
    evenly_spaced = np.isin(steps, window_steps(episode["test_horizon"]))
    verdict = judge_episode(
        steps[evenly_spaced],
        returns[evenly_spaced],
        episode["end_step"],
        episode["end_reason"],
        scale,
        episode["goal_at_end"] == 1.0,
    )
    found = {**vars(scale), **asdict(verdict)}
    return {name: found[name] for name in JUDGED}


def read_judged(path: str | Path) -> tuple[tuple[Episodes, ...], dict[str, str]]:
    """Read a table as its episodes, with the verdicts that the rules of this version give them.

    Without baselines beside it, as of an older version, a table keeps its verdicts. The file is not changed.

    Returns:
        (episodes of each task and disturbance, metadata): as `perdure.report.read_episodes`.

    Raises:
        PerdureError: As `perdure.report.read_table`, or the baselines are damaged or belong to another table.
    """
    found, notes = read_episodes(path)
    file = Path(path).parent / BASELINES
    if NOTE not in notes or not file.is_file():
        return found, notes
    if file_digest(file) != notes[NOTE]:
        raise PerdureError(
            f"{file} is damaged or belongs to another table than {path}: run the evaluation again, or remove {file} to "
            "see the verdicts that the table holds"
        )
    baselines = read_baselines(file)
    tasks = {part.facts["task"][0] for part in found}
    scales = {task: make_scales(baselines, task) for task in tasks}
    judged = tuple(judge_again(part, scales[part.facts["task"][0]]) for part in found)
    changed = sum(
        int((new.facts["outcome"] != old.facts["outcome"]).sum()) for new, old in zip(judged, found, strict=True)
    )
    if changed:
        total = sum(len(part.facts) for part in found)
        words = f"{changed} of {total} episodes have another outcome by this version's rules than in {path}"
        warn(words)
    return judged, notes


# The file of baselines


def _columns() -> dict[str, Any]:
    """Return name and type of each column: one row is one policy."""
    import polars as pl

    return {
        "policy": pl.String(),
        "train_seed": pl.Int64(),
        "horizon": pl.Int64(),
        "lengths": pl.List(pl.Int64()),
        "terminated": pl.List(pl.Boolean()),
        "rewards": pl.List(pl.Float64()),
        "idle_zero": pl.Float64(),
        "idle_random": pl.Float64(),
        "idle_discrete": pl.Boolean(),
    }


def write_baselines(folder: Path, baselines: Baselines) -> dict[str, str]:
    """Write the baselines of a table's policies into its folder; return the note that the table needs.

    The observations of the reference episodes are left out: no verdict depends on them.
    """
    import polars as pl

    rows = []
    for (policy, train_seed), baseline in baselines.items():
        reference = baseline.reference
        rows.append(
            {
                "policy": policy,
                "train_seed": train_seed,
                "horizon": reference.horizon,
                "lengths": reference.lengths.tolist(),
                "terminated": reference.terminated.tolist(),
                "rewards": reference.rewards.ravel().tolist(),
                "idle_zero": baseline.idle.zero,
                "idle_random": baseline.idle.random,
                "idle_discrete": baseline.idle.discrete,
            }
        )
    path = write_atomic(folder / BASELINES, parquet_bytes(pl.DataFrame(rows, _columns())))
    return {NOTE: file_digest(path)}


def read_baselines(path: Path) -> dict[PolicyKey, Baseline]:
    """Return what `write_baselines` wrote.

    Raises:
        PerdureError: The file is damaged.
    """
    try:
        parquet = Parquet(path.read_bytes())
        if parquet.columns != _columns():
            raise PerdureError(f"its columns must be {', '.join(_columns())}")
        return dict(_baselines(parquet.read().iter_rows(named=True)))
    except (PerdureError, TypeError, ValueError) as error:
        raise PerdureError(f"{path} cannot be read: {error}") from error


def _baselines(rows: Iterable[dict[str, Any]]) -> Iterable[tuple[PolicyKey, Baseline]]:
    """Yield the baseline of each row of the file."""
    unseen = np.zeros(0)
    for row in rows:
        lengths = np.array(row["lengths"], np.int64)
        reference = Reference(
            row["horizon"],
            np.array(row["rewards"], np.float64).reshape(len(lengths), -1),
            lengths,
            np.array(row["terminated"], np.bool_),
            unseen,
            unseen,
        )
        idle = {"zero": row["idle_zero"], "random": row["idle_random"], "discrete": row["idle_discrete"]}
        yield (row["policy"], row["train_seed"]), Baseline(reference, checked(idle, Idle, "idle robot"))
