"""Choose C by cross-validation, and by the optimistic choice.

C for a training run is the one under which the *other* training runs earn most on validation start states. What that
run earns under it on test start states is reported: neither run nor start states took part in the choice. The
optimistic choice is the C with the highest mean on the test start states of all runs, as in a figure that shows the
best C of a sweep. The difference is the bias of such a figure.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import polars as pl

from perdure.studies.errors import StudyError

Kind = str
"""Of the clocks to choose among: "constant" or "periodic"."""


@dataclass(frozen=True)
class Choice:
    """Chosen clocks of the training runs of one row, and their returns on test start states."""

    clocks: Mapping[int, str]
    """By training seed."""
    returns: Mapping[int, float]
    """On test start states, by training seed."""

    @property
    def mean(self) -> float:
        """Mean return over training runs."""
        return sum(self.returns.values()) / len(self.returns)


def cross_validated(validation: pl.DataFrame, kind: Kind = "constant", measure: str = "return") -> dict[int, str]:
    """Return the clock of each training run, chosen by all others on validation start states.

    With a single training run it is chosen by that run itself. Of equally good clocks the first one counts.

    Args:
        validation: Runs of one row, as `RowTable.runs` gives them.
        kind: Of the clocks to choose among.
        measure: What shall be high.

    Raises:
        StudyError: There is no clock of that kind.
    """
    runs = validation.filter(pl.col("clock_kind") == kind)
    if runs.is_empty():
        raise StudyError(f"there is no {kind} clock to choose among on the validation start states")
    seeds = runs["train_seed"].unique().sort().to_list()
    return {
        seed: _best(runs.filter(pl.col("train_seed") != seed) if len(seeds) > 1 else runs, measure) for seed in seeds
    }


def optimistic(test: pl.DataFrame, kind: Kind = "constant", measure: str = "return") -> str:
    """Return the clock with the highest mean over training runs on the very start states that are reported."""
    runs = test.filter(pl.col("clock_kind") == kind)
    if runs.is_empty():
        raise StudyError(f"there is no {kind} clock to choose among on the test start states")
    return _best(runs, measure)


def under(test: pl.DataFrame, clocks: Mapping[int, str], measure: str = "return") -> dict[int, float]:
    """Return the measure of each training run under its clock, by training seed.

    {} where a run is not evaluated under its clock: the others would be runs that selected themselves. A run whose
    measure has no value (null) is left out.
    """
    values = {(seed, clock): value for seed, clock, value in test.select("train_seed", "clock", measure).iter_rows()}
    if not all(pair in values for pair in clocks.items()):
        return {}
    found = {seed: values[seed, clock] for seed, clock in sorted(clocks.items())}
    return {seed: value for seed, value in found.items() if value is not None}


def choose(validation: pl.DataFrame, test: pl.DataFrame, kind: Kind = "constant") -> tuple[Choice, Choice]:
    """Return the cross-validated and the optimistic choice, both with returns on test start states."""
    chosen = cross_validated(validation, kind)
    best = optimistic(test, kind)
    always = dict.fromkeys(test["train_seed"].unique().sort().to_list(), best)
    return Choice(chosen, under(test, chosen)), Choice(always, under(test, always))


def _best(runs: pl.DataFrame, measure: str) -> str:
    means = runs.group_by("clock", "clock_steps").agg(pl.col(measure).mean()).sort("clock_steps")
    return str(means["clock"][int(means[measure].arg_max() or 0)])
