"""Episodes of a table: the same whatever the order of its rows, and what the table itself says of them."""

import dataclasses

import numpy as np
import polars as pl
import pytest

from perdure.errors import PerdureError
from perdure.report import read_episodes, write_table
from perdure.report.groups import make_groups
from perdure.report.schema import CURVES, EPISODE, table_episodes

GROUPS = [
    {"hazard": 1e-4, "rate": 2.0, "spread": 0.3},
    {"clock": "none", "method": "ppo", "hazard": 1e-4, "spread": 0.1},
    {"task": "Ant-v3", "rate": -1.0},
]


@pytest.fixture(scope="module")
def frame(synthetic):
    """Disturbed episodes of one task are shorter."""
    short = synthetic([{"disturbance": "standard-1", "ends": [200, 1001]}], 2, (3, 1), recorded=(100, 400, 1000))
    return pl.concat([synthetic(GROUPS, episodes=5, train_seeds=(3, 1)), short])


def check(tables, frame):
    """Look every episode up in the table, by its labels."""
    for episodes in tables:
        for row, facts in enumerate(episodes.facts.iter_rows(named=True)):
            mine = frame.filter(pl.all_horizontal(pl.col(name) == facts[name] for name in EPISODE)).sort("step")
            assert episodes.steps.tolist() == mine["step"].to_list()
            assert episodes.returns[row].tolist() == mine["return"].to_list()
            assert episodes.alive[row].tolist() == mine["alive"].to_list()
            assert facts["outcome"] == mine["outcome"][0]
    assert sum(len(episodes.facts) for episodes in tables) == frame.select(pl.struct(EPISODE).n_unique()).item()


def test_episodes_are_what_the_rows_say(frame):
    tables = table_episodes(frame, "t")
    check(tables, frame)
    of = [(each.facts["task"][0], each.facts["disturbance"][0], each.steps[-1]) for each in tables]
    assert of == [("Hopper-v3", "none", 100_000), ("Ant-v3", "none", 100_000), ("Hopper-v3", "standard-1", 1000)]
    assert not set(CURVES) & set(tables[0].facts.columns)


@pytest.mark.parametrize("seed", range(3))
def test_rows_in_any_order_give_the_same_episodes(frame, seed):
    check(table_episodes(frame.sample(fraction=1.0, shuffle=True, seed=seed), "t"), frame)


def test_rows_by_step_instead_of_by_episode_give_the_same_groups(frame):
    ours, others = make_groups(frame), make_groups(frame.sort("step", maintain_order=True))
    for group, other in zip(ours, others, strict=True):
        assert group.facts.equals(other.facts)
        for field in dataclasses.fields(group):
            if field.name != "facts":
                np.testing.assert_array_equal(getattr(group, field.name), getattr(other, field.name))


def test_a_file_gives_the_episodes_of_its_frame(frame, tmp_path):
    tables, notes = read_episodes(write_table(tmp_path / "t", frame, {"command": "c"}))
    check(tables, frame)
    assert notes == {"command": "c"}


def test_a_row_that_is_there_twice_is_found_wherever_it_stands(frame):
    twice = frame.filter(train_seed=1, eval_seed=2, step=500, task="Hopper-v3", method="geometric")
    with pytest.raises(
        PerdureError, match=r"the episode \('geometric', 'Hopper-v3', 1, .*, 2, 'none'\) twice at step 500"
    ):
        table_episodes(pl.concat([twice, frame]), "t")


def test_a_episode_that_lacks_a_step_another_has_is_refused(frame):
    lacks = frame.filter(~((pl.col("step") == 500) & (pl.col("eval_seed") == 1)))
    moved = frame.with_columns(step=pl.when(step=500, eval_seed=1).then(501).otherwise("step"))
    for odd in (lacks, moved):
        with pytest.raises(PerdureError, match="the episodes on Hopper-v3 do not share their recorded steps"):
            table_episodes(odd, "t")
