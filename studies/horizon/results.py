"""The frozen tables of the study, and what the analysis reads from them.

| table | one row is |
|---|---|
| `episodes.parquet` | one deployed episode: a policy, a clock, a start state |
| `learning.parquet` | a fiftieth of a training run: the mean of the training episodes that ended in it |
| `mechanism.parquet` | one measure of one training run's short rollouts, perhaps at a number of steps to go |
| `clocks.parquet` | the clock that a rule without a sweep chose for one training run |

`setting` is a task with its preset, such as "Hopper-v3@cleanrl"; `train_seed` is the training run.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import polars as pl

from perdure.errors import PerdureError
from perdure.report.estimates import thin
from perdure.report.groups import TRAINING_SCORE
from perdure.report.outcomes import WORKED, CannotTell, NeverWorked, failures, outcome_words
from studies.files import read_parquet_file, write_parquet_file
from studies.horizon.claims import SCORE, Condition
from studies.horizon.grid import Grid

TEST = "test"
VALIDATION = "validation"
RUN = ("setting", "method", "train_seed")
CURVE_POINTS = 80
"""Recorded steps that are kept of an episode, at most: what a figure draws."""
LEARNING_POINTS = 50
MEASURED = ("return", SCORE, "failed share", "training score vs published", "steps to failure")
"""Measures that episodes give; others are in the table of mechanisms."""
_UNKNOWN = pl.col("policy_state") == CannotTell.name
_WORKED = pl.col("policy_state") == WORKED
VERDICT = (
    pl.when(_UNKNOWN | (_WORKED & pl.col("outcome").is_in(outcome_words(shown_as=CannotTell.name))))
    .then(pl.lit(CannotTell.name))
    .when(~_WORKED)
    .then(pl.col("policy_state"))
    .otherwise(pl.col("outcome"))
)
"""As reports show it, but falls of a policy that cannot be judged do not count alone: shares would be of falls only."""


@dataclass(frozen=True, eq=False)
class FrozenTable:
    """A frozen table, declared once."""

    file: str
    key: tuple[str, ...]
    """Rows of one key come together, and new ones replace old ones."""
    columns: Mapping[str, pl.DataType | type[pl.DataType]]

    def read(self, out: Path) -> pl.DataFrame:
        """Return the table in a folder of results; it has no rows if there is none.

        Raises:
            PerdureError: The file is damaged, or has other columns.
        """
        path = out / self.file
        if not path.is_file():
            return pl.DataFrame(schema=self.columns)
        frame = read_parquet_file(path)
        if dict(frame.schema) != dict(pl.DataFrame(schema=self.columns).schema):
            raise PerdureError(f"{path}: its columns must be {', '.join(self.columns)}, with the types of results.py")
        return frame

    def add(self, out: Path, rows: pl.DataFrame) -> Path:
        """Write the table with new rows in the place of old ones of their keys; the same rows give the same bytes."""
        new = rows.select(pl.col(name).cast(kind) for name, kind in self.columns.items())
        kept = self.read(out).join(new.select(self.key).unique(), on=self.key, how="anti", maintain_order="left")
        order = [name for name, kind in self.columns.items() if not isinstance(kind, pl.List)]
        return write_parquet_file(out / self.file, pl.concat([kept, new]).sort(order))


EPISODES = FrozenTable(
    "episodes.parquet",
    (*RUN, "split"),
    {
        "setting": pl.String,
        "method": pl.String,
        "split": pl.String,  # "test", or "validation", on which C is chosen
        "train_seed": pl.Int64,
        "clock": pl.String,  # as on a command line: "constant:500", "countdown" (to the test horizon), "none"
        "clock_kind": pl.String,
        "clock_steps": pl.Float64,
        "eval_seed": pl.Int64,  # the start state
        "train_horizon": pl.Float64,
        "test_horizon": pl.Int64,
        "end_reason": pl.String,
        "end_step": pl.Int64,
        "idle_rate": pl.Float64,  # rewards per step of an idle robot, of the policy in training, of a published policy
        "training_rate": pl.Float64,
        "published_rate": pl.Float64,
        "policy_state": pl.String,
        "outcome": pl.String,
        "failed_step": pl.Int64,
        "end_score_vs_training": pl.Float64,
        "ever_idle": pl.Boolean,
        "return": pl.Float64,
        "curve_steps": pl.List(pl.Int32),  # of test episodes: recorded steps, and the return so far at each
        "curve": pl.List(pl.Float32),
    },
)
_RUN_COLUMNS = {"setting": pl.String, "method": pl.String, "train_seed": pl.Int64}
LEARNING = FrozenTable(
    "learning.parquet",
    RUN,
    {
        **_RUN_COLUMNS,
        "step": pl.Float64,  # training steps at the end of this fiftieth
        "episodes": pl.Int64,
        "return": pl.Float64,
        "length": pl.Float64,
    },
)
MECHANISMS = FrozenTable(
    "mechanism.parquet",
    RUN,
    {
        **_RUN_COLUMNS,
        "measure": pl.String,
        "at": pl.Int64,  # steps to go; null for a measure of the whole run
        "result": pl.Float64,
    },
)
CLOCKS = FrozenTable(
    "clocks.parquet",
    (*RUN, "rule"),
    {
        "setting": pl.String,
        "method": pl.String,
        "rule": pl.String,
        "train_seed": pl.Int64,
        "clock": pl.String,
        "simulated_steps": pl.Int64,
    },
)

TABLES = (EPISODES, LEARNING, MECHANISMS, CLOCKS)


def name_clocks(table: pl.DataFrame) -> pl.DataFrame:
    """Return clocks as on a command line: "constant:500", "periodic:500", "countdown" (to the test horizon)."""
    number = pl.col("clock_steps").fill_nan(0.0).cast(pl.Int64).cast(pl.String)
    whole = (pl.col("clock_kind") == "countdown") & (pl.col("clock_steps") == pl.col("test_horizon"))
    plain = whole | (pl.col("clock_kind") == "none")
    return table.with_columns(clock=pl.when(plain).then("clock_kind").otherwise(pl.col("clock_kind") + ":" + number))


def freeze_episodes(table: pl.DataFrame, setting: str, method: str, split: str) -> pl.DataFrame:
    """Return the rows of `EPISODES` of an evaluation, whose table has the columns of `perdure.report.schema`."""
    episode = ("train_seed", "clock", "eval_seed")
    table = name_clocks(table).sort(*episode, "step")
    steps = table["step"].unique().sort().to_numpy()
    kept = []
    if split == TEST:
        kept = [int(step) for step in steps[thin(steps, CURVE_POINTS)]]
    so_far = pl.col("return")
    step = pl.col("step")
    rows = table.group_by(episode, maintain_order=True).agg(
        pl.exclude("step", "return", "alive").last(),
        so_far.last(),
        step.filter(step.is_in(kept)).alias("curve_steps"),
        so_far.filter(step.is_in(kept)).alias("curve"),
    )
    named = rows.with_columns(setting=pl.lit(setting), method=pl.lit(method), split=pl.lit(split))
    return named.select(pl.col(name).cast(kind) for name, kind in EPISODES.columns.items())


def freeze_learning(episodes: pl.DataFrame, setting: str, method: str, train_seed: int) -> pl.DataFrame:
    """Return the rows of `LEARNING` of a training run, from its episodes: "step" (of the end), "return", "length"."""
    last = float(episodes["step"].max() or 1.0)  # type: ignore[arg-type]
    place = (pl.col("step") / last * LEARNING_POINTS).ceil().clip(1, LEARNING_POINTS)
    return (
        episodes.group_by(step=place * last / LEARNING_POINTS)
        .agg(pl.len().alias("episodes"), pl.col("return").mean(), pl.col("length").mean())
        .sort("step")
        .select(
            pl.lit(setting).alias("setting"), pl.lit(method).alias("method"), pl.lit(train_seed).alias("train_seed"),
            "step", "episodes", "return", "length",
        )
    )  # fmt: skip


def measure(episodes: pl.DataFrame) -> pl.DataFrame:
    """Return episodes with the verdict and the measures.

    A policy that never worked has failed from the start. Where the verdict is "cannot tell", what says whether an
    episode failed is null.
    """

    def judged(found: pl.Expr) -> pl.Expr:
        return pl.when(VERDICT.ne(CannotTell.name)).then(found.cast(pl.Float64))

    horizon = pl.col("test_horizon")
    idle = pl.col("idle_rate")
    never = pl.col("policy_state") == NeverWorked.name
    failed = pl.col("outcome").is_in(failures()) | never
    steps = pl.when(never).then(0).when(failed).then(pl.col("failed_step")).otherwise(horizon)
    score = (pl.col("return") - idle * pl.col("end_step")) / ((pl.col("published_rate") - idle) * horizon)
    return episodes.with_columns(
        verdict=VERDICT,
        **{
            SCORE: score,
            "failed share": judged(failed),
            "training score vs published": TRAINING_SCORE,
            "steps to failure": judged(steps),
        },
    )


@dataclass(frozen=True, eq=False)
class Results:
    """The rows of the frozen tables that belong to a grid, in its order. What is not there yet is missing."""

    grid: Grid
    episodes: pl.DataFrame
    """Of `EPISODES`, with the columns of `measure`."""
    learning: pl.DataFrame
    mechanism: pl.DataFrame
    rules: pl.DataFrame

    @cached_property
    def runs(self) -> pl.DataFrame:
        """The means of each split, clock and training run, and the number of episodes."""
        keys = ("setting", "method", "clock", "clock_kind", "clock_steps", "train_seed")
        means = [pl.col(name).mean() for name in MEASURED]
        runs = self.episodes.group_by("split", "row", *keys).agg(pl.len().alias("episodes"), *means)
        return runs.sort("row", "clock_kind", "clock_steps", "train_seed").drop("row")

    def of(self, setting: str, method: str, split: str = TEST) -> pl.DataFrame:
        """Return the runs of one setting and method on one split; no rows where it is not evaluated."""
        return self.runs.filter(split=split, setting=setting, method=method)

    @cache  # noqa: B019 - a process reads one set of results
    def values(self, setting: str, condition: Condition, measure: str = "return") -> dict[int, float]:
        """Return a measure of each training run under a condition, by training seed; {} where it is not there."""
        of_row = {"setting": setting, "method": condition.method}
        if measure not in MEASURED:
            found = self.mechanism.filter(pl.col("at").is_null(), measure=measure, **of_row)
            return dict(found.select("train_seed", "result").iter_rows())
        return values_under(self.of(**of_row), self.clocks(setting, condition), measure)

    def swept(self, setting: str, method: str, kind: str) -> dict[float, str]:
        """Return C to clock, by rising C, of the test episodes under clocks of one kind."""
        clocks = self.of(setting, method).filter(clock_kind=kind).select("clock_steps", "clock")
        return dict(clocks.unique().sort("clock_steps").iter_rows())

    def clocks(self, setting: str, condition: Condition) -> dict[int, str]:
        """Return the clock that a condition gives each training run; {} if the results do not decide it."""
        of_row = {"setting": setting, "method": condition.method}
        if condition.clock == "chosen":
            return cross_validated(self.of(**of_row, split=VALIDATION).filter(clock_kind="constant"))
        if condition.clock == "chosen periodic":
            return cross_validated(self.of(**of_row, split=VALIDATION).filter(clock_kind="periodic"))
        if condition.clock == "bandit":
            return dict(self.rules.filter(rule="bandit", **of_row).select("train_seed", "clock").iter_rows())
        clock = condition.clock
        if clock == "best":
            swept = self.of(**of_row).filter(clock_kind="constant")
            if swept.is_empty():
                return {}
            clock = best_clock(swept)
        row = self.grid.row(**of_row)
        if row is None or not clock:
            return {}
        return dict.fromkeys(row.seeds, clock)

    def deployed(self, setting: str, condition: Condition) -> pl.DataFrame:
        """Return the test episodes of a condition, by training seed and start state; none where it is not evaluated."""
        wanted = [{"train_seed": seed, "clock": clock} for seed, clock in self.clocks(setting, condition).items()]
        kinds = {name: EPISODES.columns[name] for name in ("train_seed", "clock")}
        mine = self.episodes.filter(setting=setting, method=condition.method, split=TEST)
        return mine.join(pl.DataFrame(wanted, kinds), on=list(kinds), how="semi").sort("train_seed", "eval_seed")

    def published_rate(self, setting: str) -> float:
        """Return the reward per step of a published policy; nan where none is known."""
        rates = self.episodes.filter(setting=setting, split=TEST)["published_rate"]
        if rates.is_empty():
            return float("nan")
        return float(rates[0])


def read_results(grid: Grid, out: Path) -> Results:
    """Read the frozen tables in a folder of results.

    Raises:
        PerdureError: A table is damaged.
    """
    return select(grid, *(table.read(out) for table in TABLES))


def select(
    grid: Grid, episodes: pl.DataFrame, learning: pl.DataFrame, mechanism: pl.DataFrame, clocks: pl.DataFrame
) -> Results:
    """Return the rows of the frozen tables that belong to a grid."""
    seeds = []
    for place, row in enumerate(grid.rows):
        seeds += [(row.setting, row.method, seed, place, row.evaluated) for seed in row.seeds]
    kinds = {**_RUN_COLUMNS, "row": pl.Int64, "evaluated": pl.Boolean}
    order = pl.DataFrame(seeds, schema=kinds, orient="row")

    def known(frame: pl.DataFrame) -> pl.DataFrame:
        return frame.join(order, on=RUN).sort("row", "train_seed", maintain_order=True)

    seed = pl.col("eval_seed")
    spans = [
        (pl.col("split") == each.name) & (seed >= each.first_seed) & (seed < each.first_seed + each.seeds)
        for each in grid.splits
    ]
    mine = known(episodes).filter(pl.any_horizontal(spans) & pl.col("evaluated"))
    others = (known(each).drop("row", "evaluated") for each in (learning, mechanism, clocks))
    return Results(grid, measure(mine), *others)


def cross_validated(validation: pl.DataFrame) -> dict[int, str]:
    """Return the clock of each training run: that under which the *other* runs earn most on validation start states.

    Neither the run nor the test start states take part in the choice. With a single training run it is chosen by that
    run itself.

    Args:
        validation: Runs of one row, as `Results.of` gives them, under the clocks to choose among.
    """
    seeds = validation["train_seed"].unique().sort().to_list()
    if len(seeds) == 1:
        return {seeds[0]: best_clock(validation)}
    return {seed: best_clock(validation.filter(pl.col("train_seed") != seed)) for seed in seeds}


def best_clock(runs: pl.DataFrame) -> str:
    """Return the clock with the highest mean over training runs; of equals the one with the least C.

    On the very start states that are reported this choice is optimistic.
    """
    means = runs.group_by("clock", "clock_steps").agg(pl.col("return").mean()).sort("clock_steps")
    return str(means["clock"][int(means["return"].arg_max() or 0)])


def values_under(test: pl.DataFrame, clocks: Mapping[int, str], measure: str = "return") -> dict[int, float]:
    """Return the measure of each training run under its clock, by training seed.

    {} where a run is not evaluated under its clock: the others would be runs that selected themselves. A run whose
    measure has no value (null) is left out.
    """
    values = {(seed, clock): value for seed, clock, value in test.select("train_seed", "clock", measure).iter_rows()}
    if not all(pair in values for pair in clocks.items()):
        return {}
    found = {seed: values[seed, clock] for seed, clock in sorted(clocks.items())}
    return {seed: value for seed, value in found.items() if value is not None}
