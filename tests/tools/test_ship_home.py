"""Which runs ship, and under which name."""

from importlib import import_module
from pathlib import Path

import pytest

ENV = "perdure/Home{}-v0,task=set_table,training=True{}"


@pytest.fixture
def ship(monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "tools")
    return import_module("ship_home")


def runs(ship, tmp_path, *named):
    for skill, options, folder in named:
        (tmp_path / ENV.format(skill, options) / folder / "seed-0").mkdir(parents=True)
    return sorted(ship.runs(tmp_path))


def test_a_run_ships_under_the_name_of_its_variant(ship, tmp_path):
    found = runs(
        *(ship, tmp_path),
        *(("Place", "", "place"), ("Place", ",gentle=True", "place"), ("Place", ",delta=200", "place")),
        *(("Place", "", "place-geometric"), ("Pick", ",clutter=True", "pick")),
    )
    names = ("pick", "place", "place-delta-200", "place-gentle", "place-geometric")
    assert found == sorted(f"set_table/{name}/seed-0" for name in names)


@pytest.mark.parametrize(
    "foreign",
    [
        ("Place", ",delta=1", "place"),
        ("Place", ",gentle=True", "place-linear"),
        ("Place", "", "place-ppo-average-reward"),
        ("Pick", ",clutter=True", "pick-geometric"),
        ("Pick", "", "pick"),  # trained without clutter
        ("Place", ",split=val", "place"),
        ("Place", "", "juggle"),
    ],
)
def test_what_no_recipe_makes_is_refused(ship, tmp_path, foreign):
    with pytest.raises(SystemExit, match="is no run of a recipe or a variant"):
        runs(ship, tmp_path, foreign)
