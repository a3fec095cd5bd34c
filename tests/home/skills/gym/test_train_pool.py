"""Training episodes are made once and kept."""

import numpy as np
import pytest

from perdure.errors import PerdureError
from perdure.home.skills import starts
from perdure.home.skills.starts import cache_folder, train_pool


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


@pytest.fixture(autouse=True)
def unsettled(monkeypatch):
    """Objects stay where they are put, without the seconds of simulation that show it."""

    def settle(apartment, opened, placed):
        return tuple(placed), np.zeros(len(placed)), np.zeros(len(placed))

    monkeypatch.setattr("perdure.home.tasks.generation.settle", settle)


@pytest.fixture
def count_makings(monkeypatch):
    """The indices of episodes as they are made."""
    made, real = [], starts.generate_episode

    def generate(task, split, index, *rest):
        made.append(index)
        return real(task, split, index, *rest)

    monkeypatch.setattr(starts, "generate_episode", generate)
    return made


def test_a_pool_is_made_once_and_a_damaged_one_again(count_makings, capsys):
    first = train_pool("set_table", 2)
    assert "making training episodes of set_table: 2 of 2" in capsys.readouterr().err
    assert train_pool("set_table", 2) == first
    assert count_makings == [0, 1]
    (path,) = cache_folder().glob("*.json")
    path.write_text(path.read_text().replace("set_table", "tidy_house", 1))
    assert train_pool("set_table", 2) == first
    assert count_makings == [0, 1, 0, 1]


def test_a_pool_is_in_training_apartments_of_different_layouts_and_begins_with_a_smaller_pool():
    two, one = train_pool("prepare_groceries", 2), train_pool("prepare_groceries", 1)
    assert two.episodes[:1] == one.episodes
    assert [(each.macro, each.micro, each.split) for each in two.episodes] == [(0, 0, "train"), (1, 0, "train")]


def test_episodes_of_other_code_are_not_read(monkeypatch, count_makings):
    train_pool("set_table", 1)
    monkeypatch.setattr(starts, "fingerprint", lambda: "0123456789ab")
    train_pool("set_table", 1)
    assert count_makings == [0, 0]


@pytest.mark.parametrize("wrong", [("set_table", 0), ("lay_table", 1)])
def test_a_pool_that_makes_no_sense_is_refused(wrong):
    with pytest.raises(PerdureError):
        train_pool(*wrong)
