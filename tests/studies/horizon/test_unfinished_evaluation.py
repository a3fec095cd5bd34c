"""An evaluation that is not finished is read as far as it goes, and nothing is simulated for it."""

from dataclasses import replace

import pytest
from tiny_study import CLOCKS, GRID, write_training

from perdure.extrapolate.run import StoreError, read_lanes
from perdure.studies.horizon import evaluation
from perdure.studies.horizon.evaluation import evaluate_row
from perdure.studies.study import RunOptions

TEST = GRID.split("test")
ONE = replace(TEST, seeds=1)


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """Test lanes: `ppo` with one of two start states; `geometric` with two under one clock, with one under another."""
    folder = tmp_path_factory.mktemp("study")
    write_training(folder)
    fewer = replace(GRID, swept=CLOCKS[:1]), replace(GRID, swept=CLOCKS[:2])
    for grid, row, split in ((GRID, 0, ONE), (fewer[0], 1, TEST), (fewer[1], 1, ONE)):
        evaluate_row(grid, GRID.rows[row], split, folder).run(RunOptions(on="here"))
    return folder


def read(out, row, split=TEST):
    frame = evaluate_row(GRID, GRID.rows[row], split, out).read()
    lanes = frame.select("clock", "train_seed", "eval_seed").unique().sort("clock", "train_seed", "eval_seed")
    return lanes.rows()


def test_start_states_that_every_policy_has_are_read(out, monkeypatch):
    monkeypatch.setattr(evaluation, "extrapolate", None)
    assert read(out, 0) == [("none", 0, 2000), ("none", 1, 2000)]
    one, two = "constant(100)", "constant(500)"
    both = [(one, seed, state) for seed in (0, 1) for state in (2000, 2001)]
    assert read(out, 1) == [*both, (two, 0, 2000), (two, 1, 2000)]


def test_a_confirmatory_grid_reads_a_row_only_when_every_lane_is_there(out):
    confirmatory = replace(GRID, confirmatory=True)
    assert evaluate_row(confirmatory, GRID.rows[0], TEST, out).read() is None
    assert evaluate_row(confirmatory, GRID.rows[0], ONE, out).read() is not None


def test_its_progress_counts_every_lane(out):
    counts = [evaluate_row(GRID, row, TEST, out).progress() for row in GRID.rows]
    assert [(each.done, each.total) for each in counts] == [(2, 4), (6, 16)]


def test_a_missing_lane_is_named_instead_of_simulated(out):
    step = evaluate_row(GRID, GRID.rows[0], TEST, out)
    with pytest.raises(StoreError, match="2 of 4 lanes are not in"):
        read_lanes(step.evaluation, step.folder)


def test_lanes_of_other_versions_are_read_if_there_are_no_others(out, monkeypatch):
    from perdure.extrapolate import run

    before = read(out, 1)
    monkeypatch.setattr(run, "version", lambda name: "0.0.1")
    assert read(out, 1) == before
