"""The grid holds every row of the committed table, by the commands that made them, and cannot be changed."""

import json
from dataclasses import FrozenInstanceError
from pathlib import Path

import pytest

from perdure.cli.home.run import HomeRun, make_protocol
from perdure.cli.parse import parse
from perdure.envs.registry import is_task
from perdure.studies import StudyError, find_study
from perdure.studies.placement.grid import GRIDS, make_grid

COMMITTED = json.loads((Path(__file__).parents[3] / "results" / "placement" / "tables" / "strategies.json").read_text())
THESIS = GRIDS["thesis"].rows


def test_the_thesis_rows_are_those_of_the_committed_table():
    assert sorted(row.command for row in THESIS) == COMMITTED["commands"]
    assert {(row.task, row.split, row.strategy) for row in THESIS} == {
        (row["task"], row["split"], row["strategy"]) for row in COMMITTED["rows"]
    }


def test_the_number_of_episodes_is_that_of_the_committed_table():
    made = {(row["task"], row["split"], row["strategy"]): row["episodes"] for row in COMMITTED["rows"]}
    assert {(row.task, row.split, row.strategy): row.total for row in THESIS} == made


@pytest.mark.parametrize("row", [row for grid in GRIDS.values() for row in grid.rows], ids=lambda row: row.command)
def test_the_command_of_a_row_asks_for_its_protocol(row):
    arguments = row.command.split()[3:]
    assert make_protocol(parse(HomeRun, arguments, "home run")) == row.protocol()


@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS)
def test_keys_are_distinct_and_rows_cannot_be_changed(grid):
    assert len({row.key for row in grid.rows}) == len(grid.rows)
    with pytest.raises(FrozenInstanceError):
        grid.rows[0].episodes = 1


def test_phases_choose_rows():
    assert {row.phase for row in make_grid("thesis", (2, 3)).rows} == {2, 3}
    only = make_grid("thesis", (5,))
    assert (only.rows, only.hand_over_episodes, only.noise_episodes) == ((), 100, 200)


def test_a_phase_without_work_is_refused():
    with pytest.raises(StudyError, match=r"its phases are 1$"):
        make_grid("smoke", (5,))


@pytest.mark.parametrize(("scale", "steps", "episodes"), [("smoke", 6, 12), ("laptop", 44, 42 * 30 + 8 * 30 + 10 * 60)])
def test_the_plan_counts_every_episode(tmp_path, scale, steps, episodes):
    study = find_study("placement")
    planned = study.plan(scale, tmp_path / "none", study.phases)
    assert len({step.key for step in planned}) == len(planned) == steps
    assert sum(step.amount for step in planned) == episodes
    assert all(step.progress().done == 0 for step in planned)
    assert all(is_task(step.task) for step in planned)
