"""Names of strategies in logs: the release strategy, and what is unusual in its world."""

import json
from dataclasses import asdict
from itertools import product
from typing import get_args

import pytest

from perdure.errors import PerdureError
from perdure.home.evaluate.comparison import describe
from perdure.home.evaluate.execute import ExecutorOptions
from perdure.home.evaluate.protocol import EvaluationProtocol, noted_protocol, protocol_units
from perdure.home.evaluate.strategy import Strategy
from perdure.home.sim.objects import AppleShape
from perdure.home.sim.scene import LEVERS, SceneOptions
from perdure.runs import Store

PLACES = ("rl", "stop", "ik", "guarded", "delta-50", "hand", "geometric-50")


def protocol(place, **world):
    return EvaluationProtocol("set_table", place, options=ExecutorOptions(scene=SceneOptions(**world)))


def name(place, **world):
    return protocol(place, **world).strategy.name


def test_every_strategy_and_world_has_a_name_of_its_own():
    worlds = list(product(get_args(AppleShape), LEVERS, (120, 240)))
    names = {
        name(place, apple=apple, rolling=rolling, physics_hz=hertz)
        for place, (apple, rolling, hertz) in product(PLACES, worlds)
    }
    assert len(names) == len(PLACES) * len(worlds)
    folders = {
        protocol(place, apple=apple, rolling=rolling, physics_hz=hertz).folder
        for place, (apple, rolling, hertz) in product(PLACES, worlds)
    }
    assert len(folders) == len(names)


def test_the_usual_world_has_no_name():
    assert name("ik", visuals=True) == "ik"
    assert name("ik", apple="hull", rolling=0.0, physics_hz=240) == "ik, drag only, apple a convex hull, 240 hz"
    rolling = protocol("ik", rolling=0.0004)
    assert (rolling.strategy.world, rolling.folder) == ("rolling 0.4 mm", "set_table/val/ik-rolling-0.4-mm")
    assert describe(rolling.strategy) == "stop, lower 5 cm, rolling 0.4 mm"
    assert describe(Strategy("geometric-50")) == "trained with a geometric time-to-go, always 50 steps to go"


def test_a_closed_loop_has_a_name_a_folder_and_words_of_its_own():
    options = ExecutorOptions(scene=SceneOptions(rolling=0.0), planner="closed")
    protocol = EvaluationProtocol("prepare_groceries", "ik", options=options)
    assert protocol.strategy == Strategy("ik", "drag only", "closed", "oracle")
    assert protocol.folder == "prepare_groceries/val/ik-drag-closed"
    assert noted_protocol({"protocol": json.dumps(asdict(protocol))}, "it") == protocol
    assert describe(protocol.strategy) == "stop, lower 5 cm, drag only, planned again after each skill"
    assert "open_fridge" in protocol.skills()
    assert protocol.policies_of(0)["open_fridge"].learned


def test_a_closed_loop_without_fallback_has_a_name_and_an_identity_of_its_own(tmp_path):
    protocols = [
        EvaluationProtocol("tidy_house", "rl", options=ExecutorOptions(planner="closed", fallback=fallback))
        for fallback in ("oracle", "none")
    ]
    assert [each.strategy.fallback for each in protocols] == ["oracle", "none"]
    assert [each.folder for each in protocols] == [
        f"tidy_house/val/{name}" for name in ("rl-closed", "rl-closed-no-fallback")
    ]
    assert describe(protocols[1].strategy).endswith("without fallback")
    assert noted_protocol({"protocol": json.dumps(asdict(protocols[1]))}, "it") == protocols[1]
    configs = [next(protocol_units(each, "", Store(tmp_path))).config for each in protocols]
    assert configs[1] == {**configs[0], "fallback": "none"}
    assert "fallback" not in configs[0]  # what was run before there was a choice stays valid


def test_a_log_from_before_there_was_a_choice_had_the_oracle_as_fallback():
    protocol = EvaluationProtocol("tidy_house", "rl", options=ExecutorOptions(planner="closed"))
    noted = asdict(protocol)
    del noted["options"]["fallback"]
    assert noted_protocol({"protocol": json.dumps(noted)}, "it") == protocol


def test_a_log_from_before_grasp_and_speed_were_options_is_of_the_earlier_physics():
    scene = SceneOptions(grasp="snapped", base_speed=3.0)
    noted = asdict(EvaluationProtocol("tidy_house", "rl", options=ExecutorOptions(scene=scene)))
    earlier = noted_protocol({"protocol": json.dumps(noted)}, "it")
    del noted["options"]["scene"]["grasp"], noted["options"]["scene"]["base_speed"]
    assert noted_protocol({"protocol": json.dumps(noted)}, "it") == earlier
    assert earlier.strategy.world == "snapped grasp, base 3 m per s"
    assert earlier.folder == "tidy_house/val/rl-snapped-grasp-base-3-m-per-s"


@pytest.mark.parametrize(("planner", "fallback", "word"), [("open", "none", "closed"), ("closed", "oracel", "oracle")])
def test_a_fallback_that_cannot_be_is_refused(planner, fallback, word):
    with pytest.raises(PerdureError, match=word):
        ExecutorOptions(planner=planner, fallback=fallback)


def test_a_scene_without_clutter_has_a_name_of_its_own():
    assert name("ik", clutter=False) == "ik, no clutter"


@pytest.mark.parametrize(
    "wrong", [{"rolling": "ice"}, {"physics_hz": 100}, {"apple": "pear"}, {"grasp": "firm"}, {"base_speed": 0.0}]
)
def test_values_that_are_not_allowed_are_refused_by_name(wrong):
    with pytest.raises(PerdureError, match=next(iter(wrong))):
        SceneOptions(**wrong)
