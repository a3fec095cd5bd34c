"""The grid holds every row of the committed table, by the commands that made them, and cannot be changed."""

from dataclasses import FrozenInstanceError
from pathlib import Path

import pytest

from perdure.cli.home.run import HomeRun, make_protocol
from perdure.cli.parse import parse
from perdure.errors import PerdureError
from studies.placement import study
from studies.placement.grid import GRIDS, WORLDS, make_grid
from studies.placement.tables import read_tables

TABLES = read_tables(Path(__file__).parents[3] / "results" / "placement" / "tables")


def test_the_thesis_rows_are_those_of_the_committed_table():
    made = {
        (row.task, row.split, row.strategy): (row.train_seeds, row.eval_seeds, row.total)
        for row in GRIDS["thesis"].rows
    }
    columns = ("task", "split", "strategy", "train_seeds", "eval_seeds", "episodes")
    assert made == {row[:3]: row[3:] for row in TABLES["success"].select(columns).iter_rows()}
    assert {row.strategy.partition(" ")[2] for row in GRIDS["thesis"].rows} == set(WORLDS)


@pytest.mark.parametrize("row", [row for grid in GRIDS.values() for row in grid.rows], ids=lambda row: row.command)
def test_the_command_of_a_row_asks_for_its_protocol(row):
    arguments = row.command.split()[3:]
    assert make_protocol(parse(HomeRun, arguments, "home run")) == row.protocol()


@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS)
def test_rows_are_distinct_and_cannot_be_changed(grid):
    assert len({(row.task, row.split, row.strategy) for row in grid.rows}) == len(grid.rows)
    with pytest.raises(FrozenInstanceError):
        grid.rows[0].episodes = 1


def test_phases_choose_rows():
    assert {row.phase for row in make_grid("thesis", (2, 3)).rows} == {2, 3}
    only = make_grid("thesis", (5,))
    assert (only.rows, only.hand_over_episodes, only.noise_episodes) == ((), 100, 200)


def test_a_phase_without_work_is_refused():
    with pytest.raises(PerdureError, match=r"its phases are 1$"):
        make_grid("smoke", (5,))


@pytest.mark.parametrize(("scale", "episodes"), [("smoke", 12), ("laptop", 42 * 30 + 8 * 30 + 10 * 60)])
def test_the_plan_counts_every_episode(tmp_path, scale, episodes):
    planned = study.plan(scale, tuple(study.PHASES), tmp_path / "none")
    assert len({unit.key for unit in planned}) == len(planned)
    assert sum(unit.size for unit in planned) == episodes
