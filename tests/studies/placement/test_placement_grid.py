"""The grid holds every row of the committed table, by the commands that made them."""

from itertools import product
from pathlib import Path

import pytest

from perdure import cli
from perdure.errors import PerdureError
from perdure.home.evaluate.protocol import EvaluationProtocol
from perdure.runs.identity import check_key
from studies.placement import study
from studies.placement.grid import GRIDS, make_grid
from studies.placement.tables import KEYS, read_tables

TABLES = Path(__file__).parents[3] / "results" / "placement" / "tables"


def test_the_thesis_rows_are_those_of_the_committed_table_and_those_not_run_yet():
    made = []
    for row in GRIDS["thesis"]:
        counts = row.train_seeds, row.eval_seeds, row.episodes * row.train_seeds * row.eval_seeds
        strategy = row.strategy
        what = strategy.place, strategy.world, strategy.planner, strategy.fallback
        made.append((row.task, row.split, *what, *counts))
    columns = (*KEYS, "train_seeds", "eval_seeds", "episodes")
    known = set(read_tables(TABLES)["success"].select(columns).iter_rows())
    assert len(set(made)) == len(made)
    assert known <= set(made)
    waiting = [row for row, counted in zip(GRIDS["thesis"], made, strict=True) if counted not in known]
    assert {row.fallback for row in waiting} <= {"none"}


def test_phase_5_is_the_closed_loop_with_and_without_fallback():
    rows = {(row.task, row.place, row.fallback) for row in make_grid("thesis", (5,))}
    tasks = ("set_table", "tidy_house", "prepare_groceries")
    assert rows == set(product(tasks, ("rl", "stop"), ("oracle", "none")))
    for row in make_grid("thesis", (5,)):
        assert (row.planner, row.split, row.train_seeds * row.eval_seeds * row.episodes) == ("closed", "eval", 900)


KINDS = {(name, row.task, row.split, row.strategy): row for name, grid in GRIDS.items() for row in grid}


@pytest.mark.parametrize("row", KINDS.values(), ids=lambda row: row.command)
def test_the_command_of_a_row_asks_for_its_protocol(row, monkeypatch, tmp_path):
    class AskedError(Exception):
        pass

    def policies_of(protocol, train_seed):
        raise AskedError(protocol)

    monkeypatch.setattr(EvaluationProtocol, "policies_of", policies_of)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(AskedError) as asked:
        cli.run(row.command.split()[1:])
    assert asked.value.args == (row.protocol(),)


def test_phases_choose_rows():
    assert {row.phase for row in make_grid("thesis", (2, 3))} == {2, 3}


def test_a_phase_without_work_is_refused():
    with pytest.raises(PerdureError, match=r"smoke has no work in phases 6$"):
        make_grid("smoke", (6,))


@pytest.mark.parametrize(("scale", "seeds", "episodes"), [("smoke", 1, 2), ("laptop", 3, 30)])
def test_the_plan_counts_every_episode(tmp_path, scale, seeds, episodes):
    planned = study.plan(scale, tuple(study.PHASES), tmp_path / "none")
    assert len({check_key(unit.key) for unit in planned}) == len(planned)
    assert sum(unit.size for unit in planned) == len(GRIDS[scale]) * episodes * seeds
