"""Tables of many logs: episodes, placements and failures, then counts and success by release strategy.

A run is one training seed with one evaluation seed over all episodes of a split: the benchmark's 3 x 3 runs of 100
episodes. Mean and standard error are those over the runs (as M3 and the thesis report them). Runs that share a training
seed are not independent, so training seeds are the units of the interval where there are several (Student's t below
ten of them). Where there is one, the interval is Clopper-Pearson's over episodes, which keeps a width when all succeed;
an episode that several evaluation seeds begin counts once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from perdure.errors import PerdureError
from perdure.home.evaluate import outcomes
from perdure.home.evaluate.files import check_distinct
from perdure.home.evaluate.files import columns as file_columns
from perdure.home.evaluate.log import UNTRAINED, EpisodeLog, Release, SkillRun
from perdure.home.evaluate.outcomes import COUNTINGS, DID_NOT_LAST, FAILURE_CAUSES, OTHER, SUCCESS, Counting
from perdure.home.evaluate.strategy import COLUMNS
from perdure.home.sim.arrays import FloatArray, IntArray
from perdure.home.tasks.tasks import TASKS, get_task
from perdure.stats import Interval, estimate_interval, make_units, survival_interval

if TYPE_CHECKING:
    import polars as pl

STAYED = "stayed"
"""Value of `cause` where a placement is goal-stabilizing."""
GROUP = ("task", "split", *COLUMNS)
"""What was run: columns that every table begins with. Rows with the same values are counted together."""
SAME_EPISODE = ("train_seed", "eval_seed", "index", "episode_hash")
SAME_PLACEMENT = (*SAME_EPISODE, "target")
AT_RELEASE = ("release_height", "release_offset", "object_speed", "base_speed", "tilt")


def group_of(log: EpisodeLog) -> tuple[str, ...]:
    """Return the values of `GROUP` of a log."""
    return tuple(getattr(log, name) for name in GROUP)


@dataclass(frozen=True)
class Placed:
    """A placement: a target's last release up to the end of its first place. What a closed loop repairs is none."""

    log: EpisodeLog
    target: int
    release: Release

    @property
    def run(self) -> SkillRun | None:
        """The skill in which it was released."""
        return self.log.run_at(self.release.step)

    @property
    def offset(self) -> tuple[float, float]:
        """See `outcomes.release_offset`."""
        return outcomes.release_offset(self.log, self.release)

    @property
    def displacement(self) -> FloatArray:
        """From the release to the end of its track in [m]. Shape (3,)."""
        return np.asarray(self.release.track.position[-1] - self.release.track.position[0])

    @property
    def forced(self) -> bool:
        """Whether the executor opened the hand."""
        return self.run is not None and self.run.forced_release and self.release.step == self.run.end - 1

    @property
    def place_step(self) -> int:
        """Steps of its place skill before the hand opened: the limit when forced; -1 before its first."""
        mine = (run for run in self.log.runs if (run.skill, run.target) == ("place", self.target))
        steps = [self.release.step + 1 - run.begin for run in mine]
        return min((step for step in steps if step >= 0), default=-1)

    @property
    def stays(self) -> bool:
        """Whether it is goal-stabilizing."""
        return outcomes.stays(self.log, self.target, once=True)

    @property
    def cause(self) -> str:
        """Failure cause, or `STAYED`."""
        return STAYED if self.stays else outcomes.placement_cause(self.log, self.release)

    def inside(self, step: int) -> bool:
        """Return whether the object is in its goal at a step."""
        return self.log.at(step).in_goal[self.target]


Columns = Mapping[str, tuple[type, str, Callable[[Any], Any]]]
"""Column to its type, what it holds with the unit, and how it is computed. Before them: the log's `IDENTITY`."""
IDENTITY = (*GROUP, *SAME_EPISODE)
EPISODES: Columns = {
    "success": (bool, "whether the whole task succeeded, latched", lambda log: outcomes.latched(log)[-1]),
    "stabilizing": (bool, "with every placement goal-stabilizing", lambda log: outcomes.stages_stabilizing(log)[-1]),
    "final": (bool, "see `outcomes.final_state`", outcomes.final_state),
    "scripted": (int, "skills in which the oracle acted", lambda log: sum(run.scripted for run in log.runs)),
    "outcome": (str, "see `outcomes.outcome`", outcomes.outcome),
    "seconds": (float, "duration [s]", lambda log: log.steps / log.control_hz),
    "settle_seconds": (float, "settling time after it [s]", lambda log: (log.length - log.steps) / log.control_hz),
    "force": (
        float,
        "largest contact force [N]; nan: unknown",
        lambda log: max(
            (run.force for run in log.runs if not math.isnan(run.force)), default=math.nan if log.runs else 0.0
        ),
    ),
    "diverged": (bool, "whether the simulation diverged", lambda log: log.diverged),
}
FAILURES: Columns = {
    "counting": (str, "latched or stabilizing", lambda found: found[0]),
    "stage": (str, "first unmet stage", lambda found: found[1].stage.name),
    "cause": (str, "failure cause", lambda found: found[1].cause),
    "target": (int, "number of the object", lambda found: found[1].target),
}
PLACEMENTS: Columns = {
    "target": (int, "number of the object", lambda at: at.target),
    "kind": (str, "kind of the object", lambda at: at.log.targets[at.target].kind),
    "cylinder": (bool, "whether it is a can", lambda at: at.log.targets[at.target].cylinder),
    "skill": (str, "skill in which it was released", lambda at: at.run.skill if at.run else ""),
    "place_step": (int, "steps of its place skill before the hand opened; -1: none", lambda at: at.place_step),
    "forced": (bool, "whether the hand was opened by force", lambda at: at.forced),
    "release_height": (float, "height at the release above rest [m]", lambda at: at.offset[1]),
    "release_offset": (float, "from its goal in the plane [m]", lambda at: at.offset[0]),
    "tilt": (float, "of its z axis at the release [deg]", lambda at: float(outcomes.tilt(at.release.track.up[0]))),
    "object_speed": (float, "at the release [m/s]", lambda at: at.release.object_speed),
    "gripper_speed": (float, "at the release [m/s]", lambda at: at.release.gripper_speed),
    "base_speed": (float, "at the release [m/s]", lambda at: at.release.base_speed),
    "in_goal_release": (bool, "in its goal at the release", lambda at: at.inside(at.release.step)),
    "in_goal_skill_end": (
        bool,
        "... when its first place skill ended",
        lambda at: at.inside((outcomes.handled(at.log, at.target, once=True) or (0, 1))[1] - 1),
    ),
    "in_goal_end": (bool, "... at the last step of the episode", lambda at: at.inside(at.log.steps - 1)),
    "in_goal_settled": (bool, "... at the last step of the settling time", lambda at: at.inside(at.log.length - 1)),
    "stabilizing": (bool, "whether it is goal-stabilizing", lambda at: at.stays),
    "displacement": (
        float,
        "way to the end of its track, in the plane [m]",
        lambda at: float(np.hypot(*at.displacement[:2])),
    ),
    "fall": (float, "the same, downwards [m]", lambda at: -float(at.displacement[2])),
    "cause": (str, "failure cause, or stayed", lambda at: at.cause),
    "touches": (
        int,
        "steps in which the hand touched it within two seconds; -1: unknown",
        lambda at: at.release.touches,
    ),
    "pushed": (float, "its way in these steps, in the plane [m]; nan: unknown", lambda at: at.release.pushed),
}


@dataclass(frozen=True)
class Analysis:
    """Tables made of logs. All of them begin with the columns `GROUP` and are ordered by them."""

    episodes: pl.DataFrame
    """One row per episode, see `EPISODES`."""
    placements: pl.DataFrame
    """One row per placement, see `PLACEMENTS`."""
    failures: pl.DataFrame
    """One row per failed episode and way of counting, see `FAILURES`."""
    stages: pl.DataFrame
    """Success per stage over runs, both ways of counting (figure 2-2); see `stage_table`."""
    success: pl.DataFrame
    """Success of the whole task, one row per strategy; see `success_table`."""
    seeds: pl.DataFrame
    """Success of the whole task for each training seed, both ways of counting."""
    outcomes: pl.DataFrame
    """Successes, those that did not last, failures by placement (figures 2-1, 2-3); see `outcome_table`."""
    modes: pl.DataFrame
    """How often each stage and cause came; see `mode_table`."""
    kinds: pl.DataFrame
    """Placements by object kind; see `kind_table`."""


def analyze(logs: Sequence[EpisodeLog], seed: int = 0) -> Analysis:
    """Analyze logs of any tasks, splits, strategies and seeds together; `seed` is the bootstrap's.

    Raises:
        PerdureError: If there are no logs, one episode of one strategy and its seeds is there twice, or a strategy is
            there with and without learned policies.
    """
    check_distinct(logs, "the logs")
    learned = {log.key[:3] for log in logs if log.train_seed != UNTRAINED}
    for log in logs:
        if log.train_seed == UNTRAINED and log.key[:3] in learned:
            what = f"{log.task} {log.split} {log.strategy.name}"
            raise PerdureError(f"{what}: with and without learned policies; analyze them apart")
    logs = sorted(logs, key=lambda log: log.key)
    episodes = _frame(EPISODES, ((log, log) for log in logs))
    failures = _frame(FAILURES, _failures(logs))
    placements = _frame(PLACEMENTS, _placements(logs))
    stages = stage_table(logs, np.random.default_rng(seed))
    return Analysis(
        episodes,
        placements,
        failures,
        stages,
        success_table(episodes, stages),
        seed_table(episodes),
        outcome_table(episodes),
        mode_table(failures, episodes),
        kind_table(placements),
    )


def _failures(logs: Sequence[EpisodeLog]) -> Iterator[tuple[EpisodeLog, tuple[str, outcomes.Label]]]:
    """Yield every failed episode with its way of counting and its label."""
    for way in COUNTINGS:
        for log in logs:
            found = outcomes.label(log, way)
            if found is not None:
                yield log, (way, found)


def _placements(logs: Sequence[EpisodeLog]) -> Iterator[tuple[EpisodeLog, Placed]]:
    for log in logs:
        for target in range(len(log.targets)):
            release = outcomes.placement(log, target, once=True)
            if release is not None:
                yield log, Placed(log, target, release)


def _frame(columns: Columns, rows: Iterable[tuple[EpisodeLog, Any]]) -> pl.DataFrame:
    """Return a table with a row for each (log, what the columns are computed from)."""
    import polars as pl

    # Its identity first, in the types of the log's file.
    stored = {**file_columns(), "label": pl.String()}
    schema = {name: stored[name] for name in IDENTITY}
    dtypes: dict[type, pl.DataType] = {bool: pl.Boolean(), int: pl.Int64(), float: pl.Float64(), str: pl.String()}
    for name, (kind, _, _) in columns.items():
        schema[name] = dtypes[kind]
    cells = []
    for log, each in rows:
        identity = [getattr(log, name) for name in IDENTITY]
        cells.append((*identity, *(compute(each) for _, _, compute in columns.values())))
    return pl.DataFrame(cells, schema=schema, orient="row")


def stage_table(logs: Sequence[EpisodeLog], rng: np.random.Generator) -> pl.DataFrame:
    """Return one row per group, way of counting and stage; the last stage is the task's success.

    Columns: `episodes` and `runs` that were counted, `standard_error` over the runs (nan for one run), `mean`, `lower`
    and `upper` of the 95 % interval, its `units` (training seeds, or evaluation seeds only) and `method`.

    Args:
        logs: The episodes.
        rng: The bootstrap's only source of randomness.
    """
    import polars as pl

    groups: dict[tuple[str, ...], list[EpisodeLog]] = {}
    for log in logs:
        groups.setdefault(group_of(log), []).append(log)
    parts = []
    for group, part in groups.items():
        for counting in COUNTINGS:
            first = {**dict(zip(GROUP, group, strict=True)), "counting": counting}
            parts.append(pl.DataFrame({**first, **_stage_columns(part, counting, rng)}))
    return pl.concat(parts).with_columns(pl.col("episodes", "runs").cast(pl.Int64))


def _stage_columns(logs: Sequence[EpisodeLog], counting: Counting, rng: np.random.Generator) -> dict[str, Any]:
    """Return the columns of `stage_table` of the logs of one group, counted in one way."""
    count = outcomes.latched if counting == "latched" else outcomes.stages_stabilizing
    reached = np.array([count(log) for log in logs], dtype=np.float64)
    # The standard error is that of the mean over runs.
    runs = np.array([f"{log.train_seed} {log.eval_seed}" for log in logs])
    means = np.stack([reached[runs == run].mean(axis=0) for run in np.unique(runs)])
    error: FloatArray | float = math.nan
    if len(means) > 1:
        error = means.std(axis=0, ddof=1) / math.sqrt(len(means))
    # An episode that several evaluation seeds begin counts once, as its mean.
    by_episode, seeds = episode_means(reached, logs)
    found = survival_interval(by_episode, seeds, rng)
    return {
        "stage": [stage.name for stage in logs[0].home_task.stages],
        "episodes": len(logs),
        "runs": len(means),
        "mean": found.estimate,
        "standard_error": error,
        "lower": found.lower,
        "upper": found.upper,
        "units": found.label,
        "method": found.method,
    }


def episode_means(values: FloatArray, logs: Sequence[EpisodeLog]) -> tuple[FloatArray, IntArray]:
    """Return the mean of the values of each training seed and episode, over its evaluation seeds, and the seeds.

    `values` has the shape (logs, ...), the means (episodes, ...), the training seeds (episodes,).
    """
    keys = np.array([(log.train_seed, log.index) for log in logs])
    episodes, number = np.unique(keys, axis=0, return_inverse=True)
    means = [values[number.ravel() == k].mean(axis=0) for k in range(len(episodes))]
    return np.array(means), episodes[:, 0]


def success_table(episodes: pl.DataFrame, stages: pl.DataFrame) -> pl.DataFrame:
    """Return one row per group: how much was run, and the success of the whole task.

    `train_seeds`, `eval_seeds`, `episodes`; mean, standard error and bounds of the 95 % interval by both ways of
    counting (`latched mean`), `method` of the interval; `did_not_last`: latched successes that did not last;
    `diverged`; `final`: episodes that end in the final state, `unaided`: those of them without a scripted skill.
    """
    import polars as pl

    counted = episodes.group_by(GROUP, maintain_order=True).agg(
        pl.col("train_seed").n_unique().cast(pl.Int64).alias("train_seeds"),
        pl.col("eval_seed").n_unique().cast(pl.Int64).alias("eval_seeds"),
        pl.len().cast(pl.Int64).alias("episodes"),
        did_not_last=(pl.col("outcome") == DID_NOT_LAST).sum().cast(pl.Int64),
        diverged=pl.col("diverged").sum().cast(pl.Int64),
        final=pl.col("final").sum().cast(pl.Int64),
        unaided=(pl.col("final") & (pl.col("scripted") == 0)).sum().cast(pl.Int64),
    )
    for counting in COUNTINGS:
        final = stages.filter(counting=counting).group_by(GROUP).last()
        named = {f"{counting} {name}": pl.col(name) for name in ("mean", "standard_error", "lower", "upper")}
        how = ["method"] if counting == COUNTINGS[0] else []
        counted = counted.join(final.select(*GROUP, *how, **named), on=GROUP, how="left", maintain_order="left")
    return counted


def seed_table(episodes: pl.DataFrame) -> pl.DataFrame:
    """Return the success of the whole task for each training seed: `latched` and `stabilizing`."""
    import polars as pl

    return episodes.group_by(*GROUP, "train_seed", maintain_order=True).agg(
        latched=pl.col("success").mean(), stabilizing=pl.col("stabilizing").mean()
    )


def outcome_table(episodes: pl.DataFrame) -> pl.DataFrame:
    """Return the `count` of each outcome, its share `of_all` episodes, and `of_failed` ones (null for successes)."""
    import polars as pl

    rows = []
    for group, part in episodes.group_by(GROUP, maintain_order=True):
        found = part["outcome"].to_list()
        places = [stage.name for stage in get_task(str(group[0])).stages if stage.placed is not None]
        rows += [(*group, name, found.count(name)) for name in (SUCCESS, DID_NOT_LAST, *places, OTHER)]
    return outcome_shares(pl.DataFrame(rows, schema=[*GROUP, "outcome", "count"], orient="row"))


def outcome_shares(counted: pl.DataFrame) -> pl.DataFrame:
    """Return a table of outcomes with the shares `of_all` and `of_failed`."""
    import polars as pl

    failed = ~pl.col("outcome").is_in([SUCCESS, DID_NOT_LAST])
    total = pl.col("count").filter(failed).sum().over(GROUP)
    return counted.with_columns(
        of_all=pl.col("count") / pl.col("count").sum().over(GROUP),
        of_failed=pl.when(failed & (total > 0)).then(pl.col("count") / total),
    )


def mode_table(failures: pl.DataFrame, episodes: pl.DataFrame) -> pl.DataFrame:
    """Return the `count` of each stage and cause, in order, its share `of_all` episodes and `of_failed` ones."""
    import polars as pl

    keys = [*GROUP, "counting"]
    counted = failures.group_by(*keys, "stage", "cause").agg(count=pl.len().cast(pl.Int64))
    stages = {f"{task} {stage.name}": k for task in TASKS for k, stage in enumerate(get_task(task).stages)}
    causes = {cause: k for k, cause in enumerate(FAILURE_CAUSES)}
    return (
        counted.join(episodes.group_by(GROUP).agg(episodes=pl.len()), on=GROUP)
        .sort(
            *keys,
            pl.format("{} {}", "task", "stage").replace_strict(stages, return_dtype=pl.Int64),
            pl.col("cause").replace_strict(causes, return_dtype=pl.Int64),
        )
        .select(
            pl.exclude("episodes"),
            of_all=pl.col("count") / pl.col("episodes"),
            of_failed=pl.col("count") / pl.col("count").sum().over(keys),
        )
    )


def kind_table(placements: pl.DataFrame) -> pl.DataFrame:
    """Return placements by object kind: their number, how many did not stay, the rate, medians at the release."""
    import polars as pl

    counted = placements.group_by(*GROUP, "kind", "cylinder").agg(
        pl.col(AT_RELEASE).median(),
        placements=pl.len().cast(pl.Int64),
        failures=(~pl.col("stabilizing")).sum().cast(pl.Int64),
    )
    return counted.with_columns(rate=pl.col("failures") / pl.col("placements")).sort(*GROUP, "kind", "cylinder")


def paired_difference(
    first: pl.DataFrame, second: pl.DataFrame, column: str = "stabilizing", keys: tuple[str, ...] = SAME_EPISODE
) -> Interval:
    """Return the mean difference in success, second minus first, over the episodes that both ran.

    Episodes are paired by training seed, evaluation seed, number and hash: the same start and goals. The differences
    are averaged within a training seed; training seeds are the units of the 95 % interval. With one training seed the
    episodes are, with all evaluation seeds and placements, and the interval says nothing about training again.

    Args:
        first: Rows of `Analysis.episodes` of one release strategy, or of `Analysis.placements`.
        second: Of the other, in the same task and split.
        column: `stabilizing`, or `success` (latched) of episodes.
        keys: What makes a pair: `SAME_EPISODE`, or `SAME_PLACEMENT` for placements of the same object.

    Raises:
        PerdureError: If the two have no pair.
    """
    import polars as pl

    both = first.select(*keys, pl.col(column).alias("first")).join(
        second.select(*keys, pl.col(column).alias("second")), on=keys
    )
    if both.is_empty():
        raise PerdureError("the two release strategies have no episode of equal training and evaluation seed in common")
    change = pl.col("second").cast(pl.Float64) - pl.col("first").cast(pl.Float64)
    same = [name for name in keys if name not in ("eval_seed", "target")]
    changes = both.group_by(same, maintain_order=True).agg(change.mean().alias("change"))
    units = make_units(changes["change"].to_numpy(), changes["train_seed"].to_numpy())
    return estimate_interval(units, np.random.default_rng(0)).within(-1.0, 1.0)
