"""One episode is run as a step of the study; its logs replace one committed row and nothing else."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from perdure.runs import Store, attempt
from perdure.studies import RunOptions, StudyError
from perdure.studies.placement.grid import Grid, Row, runs_folder
from perdure.studies.placement.hand_over import SCHEMA, hand_over_step
from perdure.studies.placement.release_speed import speed_figures, speed_table
from perdure.studies.placement.results import Results
from perdure.studies.placement.row_step import RunRow
from perdure.studies.placement.tables import read_tables, update_tables

COMMITTED = Path(__file__).parents[3] / "results" / "placement" / "tables"
ROW = Row("set_table", "ik", "eval", "drag", 1, 1, 1, 1)
GRID = Grid("tiny", (ROW,), hand_over_episodes=1)


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """Results with the committed tables and the logs of one episode."""
    folder = tmp_path_factory.mktemp("placement")
    shutil.copytree(COMMITTED, folder / "tables")
    step = RunRow(GRID, ROW, folder)
    assert step.progress().done == 0
    step.run(RunOptions(cores=1))
    return folder


def subject(row):
    return row["task"], row["split"], row["strategy"]


def test_a_finished_step_has_nothing_left(out):
    progress = RunRow(GRID, ROW, out).progress()
    assert (progress.total, progress.done, progress.share) == (1, 1, 1.0)


def test_a_row_of_which_episodes_are_missing_keeps_its_numbers(out):
    more = replace(GRID, rows=(replace(ROW, eval_seeds=2),))
    assert RunRow(more, more.rows[0], out).progress().done == 1
    assert update_tables(more, out).results == read_tables(out).results


def test_a_row_without_policies_fails_alone(out):
    missing = RunRow(GRID, replace(ROW, place="delta-7"), out)
    with pytest.raises(StudyError, match="no policy is shipped for delta-7 on set_table"):
        missing.run(RunOptions(cores=1))


def test_logs_replace_their_row_and_no_other(out):
    before, after = read_tables(out).results, update_tables(GRID, out).results
    new = {subject(row): row for row in after.rows}
    changed = {subject(row) for row in before.rows if new[subject(row)] != row}
    assert changed == {("set_table", "eval", "ik drag")}
    assert len(after.rows) == len(before.rows)
    gone = [pair for pair in before.pairs if pair not in after.pairs]
    assert {pair["strategy"] for pair in gone} == {"ik - rl drag", "ik - stop drag", "ik+ - ik drag"}
    assert {(pair["task"], pair["split"]) for pair in gone} == {("set_table", "eval")}
    assert set(map(str, after.pairs)) < set(map(str, before.pairs))
    assert set(after.commands) - set(before.commands) == {ROW.command}


def test_results_of_one_seed_are_read_again(out, tmp_path):
    written = update_tables(GRID, out).results.write(tmp_path / "strategies.json")
    assert "NaN" in written.read_text()  # one episode has no interval
    assert Results.read(written).write(tmp_path / "again.json").read_bytes() == written.read_bytes()


def test_the_new_row_tells_what_the_episode_did(out):
    row = next(row for row in update_tables(GRID, out).results.rows if subject(row) == ("set_table", "eval", "ik drag"))
    assert "earlier_run" not in row
    assert (row["episodes"], row["seeds"]) == (1, {"train": 1, "eval": 1})
    placed = sum(kind["placements"] for kind in row["kinds"].values())
    assert placed == sum(row["hand_overs"].values()) > 0
    assert row["stages"]["latched"]["close_1"] == row["latched"]["mean"] == 1.0 - row["failed"]


def test_release_speeds_count_every_placement(out):
    counts = update_tables(GRID, out).speeds
    row = next(row for row in update_tables(GRID, out).results.rows if subject(row) == ("set_table", "eval", "ik drag"))
    assert counts["placements"].sum() == sum(kind["placements"] for kind in row["kinds"].values())
    assert not counts["in_motion"].any()
    assert "1 of 1" in speed_table(counts)
    assert list(speed_figures(counts)) == []  # too few, and none in motion


def test_a_measurement_keeps_its_numbers_until_all_units_are_there(out):
    step = hand_over_step(GRID, out)
    committed = read_tables(out).hand_over
    attempt(runs_folder(out), step.units[0])
    assert step.progress().done == 1
    assert update_tables(GRID, out).hand_over.equals(committed)
    summary = json.loads((Store(runs_folder(out)).get(step.units[0].key) / "summary.json").read_text())
    assert list(summary) == list(SCHEMA)
    assert (summary["descent"], summary["blocked"], summary["out_of_reach"]) == (0.0, 0, 0)
