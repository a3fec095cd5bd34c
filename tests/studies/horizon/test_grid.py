"""The grid names the training runs that are committed, and splits share no start state."""

from itertools import combinations
from pathlib import Path

import pytest

from perdure.errors import PerdureError
from perdure.learn import METHODS
from perdure.policy import load_policy
from studies.horizon.grid import GRIDS, PHASES, make_grid
from studies.horizon.results import LEARNING
from studies.horizon.study import grid_units, plan, row_config

POLICIES = Path(__file__).parents[3] / "results" / "horizon" / "policies"
THESIS = make_grid("thesis", tuple(PHASES))


EVALUATED = [row for row in THESIS.rows if row.evaluated]


def test_every_training_run_of_the_grid_is_committed():
    committed = {path.relative_to(POLICIES).as_posix() for path in POLICIES.rglob("*.safetensors")}
    assert committed >= {f"{row.key}/seed-{seed}.safetensors" for row in EVALUATED for seed in row.seeds}
    runs = set(LEARNING.read(POLICIES.parent).select("setting", "method", "train_seed").unique().rows())
    assert runs >= {(row.setting, row.method, seed) for row in THESIS.rows for seed in row.seeds}


@pytest.mark.parametrize("row", EVALUATED, ids=lambda row: row.key)
def test_the_grid_s_settings_are_those_of_the_committed_runs(row):
    for seed in (row.seeds[0], row.seeds[-1]):
        provenance = load_policy(POLICIES / row.key / f"seed-{seed}.safetensors").provenance
        assert (provenance["method"], provenance["seed"]) == (row.method, seed)
        assert provenance["config"] == row_config(THESIS, row).to_json()


@pytest.mark.parametrize("name", [name for name, grid in GRIDS.items() if len(grid.splits) > 1])
def test_splits_share_no_start_state(name):
    seeds = [set(range(split.first_seed, split.first_seed + split.seeds)) for split in GRIDS[name].splits]
    assert all(not one & other for one, other in combinations(seeds, 2))


@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS)
def test_rows_are_known_methods_and_none_stands_twice(grid):
    keys = [row.key for row in grid.rows]
    assert len(keys) == len(set(keys))
    assert {row.method for row in grid.rows} <= set(METHODS)


def test_phases_without_a_row_are_refused():
    with pytest.raises(PerdureError, match="has no work in phases"):
        make_grid("smoke", (5,))


def test_every_unit_comes_after_its_training():
    units = list(grid_units(GRIDS["smoke"], Path("nowhere")))
    keys = [unit.key for unit in units]
    assert len(keys) == len(set(keys))
    for place, unit in enumerate(units):
        assert set(unit.after) <= set(keys[:place])


def test_only_methods_that_observe_c_are_evaluated_where_c_is_chosen():
    keys = [unit.key.split("/") for unit in plan("thesis", (1, 3), Path("nowhere"))]
    methods = {
        name: {key[3].partition("@")[0] for key in keys if key[:2] == ["evaluation", name]}
        for name in ("validation", "test")
    }
    assert methods["validation"] == {"geometric", "geometric-fixed"}
    assert {"ppo", "linear", "random-horizon"} < methods["test"]
