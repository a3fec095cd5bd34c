"""Names of strategies: each made of one way and one world, and read back."""

from itertools import product
from typing import get_args

import pytest

from perdure.home.errors import HomeError
from perdure.home.evaluate.execute import ExecutorOptions
from perdure.home.evaluate.protocol import read_strategy, strategy_name
from perdure.home.sim.world import Jaws, Rolling, SceneOptions

PLACES = ("rl", "stop", "ik", "ik+", "delta-50", "delta-50-in-200")
WORLDS = tuple(product(get_args(Jaws), get_args(Rolling), (120, 240)))


def options(jaws, rolling, physics_hz):
    return ExecutorOptions(jaws=jaws, scene=SceneOptions(rolling=rolling, physics_hz=physics_hz))


def test_names_of_arms_are_read_back():
    names = set()
    for place, world in product(PLACES, WORLDS):
        name = strategy_name(place, options(*world))
        names.add(name)
        assert read_strategy(name) == (place, options(*world))
    assert len(names) == len(PLACES) * len(WORLDS)


def test_the_usual_world_has_no_name():
    assert strategy_name("ik", ExecutorOptions(lanes=3, threads=1, eval_seed=7)) == "ik"
    assert strategy_name("ik", options("apart", "drag", 240)) == "ik jaws-apart drag 240-hz"


@pytest.mark.parametrize(("word", "scene"), [("no-clutter", {"clutter": False}), ("no-sleep", {"sleep": False})])
def test_a_scene_without_clutter_or_sleep_has_a_name_of_its_own(word, scene):
    unusual = ExecutorOptions(scene=SceneOptions(**scene))
    assert strategy_name("ik", unusual) == f"ik {word}"
    assert read_strategy(f"ik {word}") == ("ik", unusual)


@pytest.mark.parametrize(
    "name",
    [
        "TP+SRL",
        "throw drag",
        "ik drag jaws-apart",
        "ik friction",
        "ik 120-hz",
        "ik 0-hz",
        "ik 60-hz",
        "ik 100-hz",
        "ik \u00b2-hz",
        "delta-\u00b2",
        "ik  drag",
        "ik ",
        "",
    ],
)
def test_other_names_are_refused(name):
    with pytest.raises(HomeError, match=r"is no release strategy of this package: .* rl, stop, ik, ik\+") as refused:
        read_strategy(name)
    assert repr(name) in str(refused.value)
