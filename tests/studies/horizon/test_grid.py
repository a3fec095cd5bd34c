"""The grid names the training runs that are committed, and splits share no start state."""

import json
from itertools import combinations
from pathlib import Path

import pytest

from perdure.ppo import METHODS
from perdure.studies import StudyError, find_study
from perdure.studies.horizon.grid import DEFAULT_PHASES, GRIDS, PHASES, make_grid
from perdure.studies.horizon.training import train_run

RESULTS = Path(__file__).parents[3] / "results" / "horizon"
THESIS = make_grid("thesis", DEFAULT_PHASES)
EVERYTHING = make_grid("thesis", tuple(PHASES))


def test_every_committed_training_run_is_in_the_grid():
    committed = {
        path.parent.relative_to(RESULTS / "training").as_posix() for path in RESULTS.rglob("training/**/run.json")
    }
    assert committed >= {f"{row.key}/seed-{seed}" for row in THESIS.rows for seed in row.seeds}
    assert committed <= {f"{row.key}/seed-{seed}" for row in EVERYTHING.rows for seed in row.seeds}


def record(row, seed):
    return RESULTS / "training" / row.key / f"seed-{seed}" / "run.json"


COMMITTED = [
    (row, [seed for seed in row.seeds if record(row, seed).is_file() or row.phase in DEFAULT_PHASES])
    for row in EVERYTHING.rows
]


@pytest.mark.parametrize(("row", "seeds"), [pytest.param(*each, id=each[0].key) for each in COMMITTED if each[1]])
def test_the_grid_s_settings_are_those_of_the_committed_runs(row, seeds):
    run = train_run(EVERYTHING, row)
    for seed in seeds:
        assert json.loads(record(row, seed).read_text()) == run.identity(seed)


def test_other_settings_would_be_noticed():
    row = THESIS.rows[0]
    run = train_run(make_grid("smoke", (1,)), row)
    kept = json.loads((RESULTS / "training" / run.key(0) / "run.json").read_text())
    assert kept != run.identity(0)


@pytest.mark.parametrize("name", [name for name, grid in GRIDS.items() if len(grid.splits) > 1])
def test_splits_share_no_start_state(name):
    seeds = [set(range(split.first_seed, split.first_seed + split.seeds)) for split in GRIDS[name].splits]
    assert all(not one & other for one, other in combinations(seeds, 2))


@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS)
def test_rows_are_known_methods_and_none_stands_twice(grid):
    keys = [row.key for row in grid.rows]
    assert len(keys) == len(set(keys))
    assert {row.method for row in grid.rows if row.gamma is None} <= set(METHODS)


def test_the_replication_trains_and_tests_on_nothing_that_suggested_it():
    rows = {row.key: set(row.seeds) for row in EVERYTHING.rows}
    fresh = GRIDS["replication"]
    assert all(not rows[row.key] & set(row.seeds) for row in fresh.rows)
    seen = {split.first_seed + number for split in EVERYTHING.splits for number in range(split.seeds)}
    assert all(not seen & set(range(each.first_seed, each.first_seed + each.seeds)) for each in fresh.splits)


def test_a_gamma_row_changes_gamma_alone():
    grid = make_grid("thesis", (4,))
    row = next(row for row in grid.rows if row.gamma == 0.95)
    protocol = train_run(grid, row).config.protocol
    assert (protocol.gamma, protocol.embedding, protocol.end) == (0.95, None, "truncated")


def test_phases_without_a_row_are_refused():
    with pytest.raises(StudyError, match="its phases are 1"):
        make_grid("smoke", (5,))


def test_evaluation_follows_training():
    study = find_study("horizon")
    steps = study.plan("smoke", Path("nowhere"), study.phases)
    keys = [step.key for step in steps]
    assert len(keys) == len(set(keys))
    for place, step in enumerate(steps):
        assert set(step.after) <= set(keys[:place])


def test_only_methods_that_observe_c_are_evaluated_where_c_is_chosen():
    study = find_study("horizon")
    steps = study.plan("thesis", Path("nowhere"), (1, 3))
    methods = {
        name: {step.row.method for step in steps if step.stage == f"evaluation {name}"}
        for name in ("validation", "test")
    }
    assert methods["validation"] == {"geometric", "geometric-fixed"}
    assert {"ppo", "linear", "random-horizon"} < methods["test"]
