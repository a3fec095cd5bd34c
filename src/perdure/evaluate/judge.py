"""Judging: the verdict columns of a table, computed from its raw columns and from the baselines of its policies.

A baseline is what the rewards of a policy are compared with: its reference episodes, and an idle robot. It is written
beside the table, so that other rules can judge stored episodes without a simulator (`read_judged`).
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from perdure.envs.suites import is_contract
from perdure.errors import PerdureError, PerdureWarning
from perdure.evaluate.episodes import window_steps
from perdure.evaluate.reference import Idle
from perdure.evaluate.verdict import ScoreScale, judge_episode, make_score_scale, published_rate
from perdure.policy import Reference
from perdure.report.schema import COLUMNS, JUDGED, Episodes, read_episodes
from perdure.report.work import WORK, Curve, with_work
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
_OF_EPISODE = tuple(name for name in JUDGED if name not in WORK)
"""Judged columns that follow from an episode alone."""


@dataclass(frozen=True, eq=False)
class Baseline:
    """What the rewards of a policy are compared with."""

    reference: Reference
    """The policy within its training horizon."""
    idle: Idle
    """An idle robot in the same task."""
    other_engine: str = ""
    """In what it was trained and in what it is judged, if these differ, see `other_engine`."""

    def scale(self, task: str) -> ScoreScale:
        """Return the score scale of the policy in a task, such as "Hopper-v3"."""
        scale = make_score_scale(self.reference, self.idle, published_rate(task), is_contract(task))
        return replace(scale, idle_steps=self.idle.steps, other_engine=self.other_engine)


Baselines = Mapping[PolicyKey, Baseline]
_MUJOCO = re.compile(r"MuJoCo (\d+\.\d+\.\d+)")


def other_engine(trained: str, judged: str) -> str:
    """Return in what a policy was trained and is judged, if its versions of MuJoCo differ; "" if not, or unknown.

    What is around MuJoCo does not count: tasks of EnvPool and Gymnasium are equal to 1e-9, Humanoid to 1e-7.

    Args:
        trained: Engine of the training, such as "EnvPool 1.2.5, MuJoCo 3.6.0", or "".
        judged: That of the evaluation.
    """
    before = _MUJOCO.search(trained)
    now = _MUJOCO.search(judged)
    versions = [None if found is None else found[1] for found in (before, now)]
    if not trained or versions[0] == versions[1]:
        return ""
    return f"trained in {trained}, judged in {judged}"


def make_scales(baselines: Baselines, task: str) -> Scales:
    """Return the score scale of each policy in a task."""
    return {key: baseline.scale(task) for key, baseline in baselines.items()}


# Judging


def judge_table(frame: pl.DataFrame, scales: Scales) -> pl.DataFrame:
    """Return a table with the columns that are judged, `JUDGED`.

    Args:
        frame: Raw columns of one task, as `episode_table` makes them, episode after episode; they may differ in
            disturbances and steps.
        scales: The score scale of each policy.
    """
    last = np.flatnonzero(frame["step"] == frame["test_horizon"])
    begins = np.concatenate([[0], last[:-1] + 1])
    grid = frame["step"].to_numpy()
    returns = frame["return"].to_numpy()
    curves = [(grid[begin:end], returns[begin:end]) for begin, end in zip(begins, last + 1, strict=True)]
    judged = with_work(_judge(frame[last], curves, scales), curves).select(JUDGED)
    return frame.drop(JUDGED, strict=False).hstack(judged[np.repeat(np.arange(len(last)), last + 1 - begins)])


def judge_again(parts: Sequence[Episodes], scales: Mapping[str, Scales]) -> tuple[Episodes, ...]:
    """Return the episodes of a stored table with the columns that are judged computed anew.

    Args:
        parts: All episodes of the table.
        scales: By task, the score scale of each policy.
    """
    judged = [replace(part, facts=_judge(part.facts, _curves(part), scales[part.facts["task"][0]])) for part in parts]
    return _work_again(judged)


def _work_again(parts: Sequence[Episodes]) -> tuple[Episodes, ...]:
    """Return the episodes with their work: of all columns but `WORK`."""
    import polars as pl

    curves = [curve for part in parts for curve in _curves(part)]
    facts = with_work(pl.concat([part.facts for part in parts]), curves)
    found = []
    begin = 0
    for part in parts:
        found.append(replace(part, facts=facts.slice(begin, len(part.facts))))
        begin += len(part.facts)
    return tuple(found)


def _curves(part: Episodes) -> list[Curve]:
    return [(part.steps, returns) for returns in part.returns]


def _judge(episodes: pl.DataFrame, curves: Iterable[Curve], scales: Scales) -> pl.DataFrame:
    """Return episodes, one row for each, with the columns that follow from each of them alone: all but `WORK`."""
    import polars as pl

    rows = []
    for episode, (steps, returns) in zip(episodes.iter_rows(named=True), curves, strict=True):
        rows.append(_judged_row(episode, steps, returns, scales))
    return episodes.with_columns(pl.DataFrame(rows, {name: COLUMNS[name] for name in _OF_EPISODE}))


def _judged_row(
    episode: Mapping[str, Any], steps: NDArray[np.int64], returns: NDArray[np.float64], scales: Scales
) -> dict[str, Any]:
    """Return the judged columns of one episode but its work.

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
    return {name: found[name] for name in _OF_EPISODE}


def read_judged(path: str | Path) -> tuple[tuple[Episodes, ...], dict[str, str]]:
    """Read a table as its episodes, with the verdicts that the rules of this version give them.

    Without baselines beside it, as of an older version, a table keeps its verdicts, and only the columns that its
    version lacked are computed. The file is not changed.

    Returns:
        (episodes of each task and disturbance, metadata): as `perdure.report.read_episodes`.

    Raises:
        PerdureError: As `perdure.report.read_table`, or the baselines are damaged or belong to another table.
    """
    found, notes = read_episodes(path)
    file = Path(path).parent / BASELINES
    if NOTE not in notes or not file.is_file():
        return _work_again(found), notes
    if file_digest(file) != notes[NOTE]:
        raise PerdureError(
            f"{file} is damaged or belongs to another table than {path}: run the evaluation again, or remove {file} to "
            "see the verdicts that the table holds"
        )
    baselines = read_baselines(file)
    tasks = {part.facts["task"][0] for part in found}
    scales = {task: make_scales(baselines, task) for task in tasks}
    judged = judge_again(found, scales)
    changed = sum(
        int((new.facts["outcome"] != old.facts["outcome"]).sum()) for new, old in zip(judged, found, strict=True)
    )
    if changed:
        total = sum(len(part.facts) for part in found)
        words = f"{changed} of {total} episodes have another outcome by this version's rules than in {path}"
        warnings.warn(PerdureWarning(words), stacklevel=2)
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
        "idle_zero_steps": pl.Float64(),
        "idle_random_steps": pl.Float64(),
        "other_engine": pl.String(),
    }


_ADDED = {"idle_zero_steps": None, "idle_random_steps": None, "other_engine": ""}
"""Columns that files of earlier versions lack, and what they then hold."""


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
                "idle_zero_steps": baseline.idle.zero_steps,
                "idle_random_steps": baseline.idle.random_steps,
                "other_engine": baseline.other_engine,
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
        expected = {name: kind for name, kind in _columns().items() if name in parquet.columns or name not in _ADDED}
        if parquet.columns != expected:
            raise PerdureError(f"its columns must be {', '.join(_columns())}")
        return dict(_baselines(parquet.read().iter_rows(named=True)))
    except (PerdureError, TypeError, ValueError) as error:
        raise PerdureError(f"{path} cannot be read: {error}") from error


def _baselines(rows: Iterable[dict[str, Any]]) -> Iterable[tuple[PolicyKey, Baseline]]:
    """Yield the baseline of each row of the file."""
    unseen = np.zeros(0)
    for row in rows:
        row = _ADDED | row
        lengths = np.array(row["lengths"], np.int64)
        reference = Reference(
            row["horizon"],
            np.array(row["rewards"], np.float64).reshape(len(lengths), -1),
            lengths,
            np.array(row["terminated"], np.bool_),
            unseen,
            unseen,
        )
        idle = {name.removeprefix("idle_"): value for name, value in row.items() if name.startswith("idle_")}
        baseline = Baseline(reference, checked(idle, Idle, "idle robot"), row["other_engine"])
        yield (row["policy"], row["train_seed"]), baseline
