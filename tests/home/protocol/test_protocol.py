"""The protocol: which units, who acts, and that a second call runs nothing again."""

import json

import pytest

from perdure.home.arms import Ik
from perdure.home.errors import HomeError
from perdure.home.execute import ExecutorOptions, Scripted
from perdure.home.oracle import Oracle
from perdure.home.outcomes import read_logs, read_notes
from perdure.home.protocol import Protocol, choose_policies, make_actors, run_protocol, units
from perdure.home.protocol.policies import SHIPPED, SkillPolicy
from perdure.home.tasks import get_task
from perdure.store import StoreError


def test_units_cover_every_episode_of_every_seed_once():
    protocol = Protocol("set_table", episodes=25, train_seeds=2, eval_seeds=3)
    seen = [
        (unit.train_seed, unit.eval_seed, episode)
        for unit in units(protocol)
        for episode in range(unit.first, unit.last + 1)
    ]
    assert sorted(seen) == [(t, e, k) for t in range(2) for e in range(3) for k in range(25)]
    keys = [unit.key(protocol) for unit in units(protocol)]
    assert len(set(keys)) == len(keys)


def test_what_was_run_is_not_run_again(tmp_path):
    nobody = {step.skill: "oracle" for step in get_task("set_table").skills if step.skill != "reset_arm"}
    protocol = Protocol("set_table", episodes=1, policies=nobody, options=ExecutorOptions(lanes=1))
    told = []
    first = run_protocol(protocol, tmp_path, told.append, "asked by a test")
    second = run_protocol(protocol, tmp_path, told.append)
    assert first == second
    assert [log.episode.name for log in told] == ["set_table/val/000"]
    (record,) = read_logs(first[0])
    assert record.index == 0
    notes = read_notes(first[0])
    assert json.loads(notes["policies"])["place"] == "oracle"
    assert (notes["command"], notes["train_seed"]) == ("asked by a test", "-1")


def test_other_settings_under_the_same_name_are_refused(tmp_path):
    def protocol(jaws):
        options = ExecutorOptions(lanes=1, jaws=jaws, settle_steps=2)
        return Protocol("set_table", episodes=1, policies={"place": "oracle"}, options=options)

    run_protocol(protocol("never"), tmp_path)
    with pytest.raises(StoreError, match="jaws"):
        run_protocol(protocol("apart"), tmp_path)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"task": "make_coffee"}, "make_coffee"),
        ({"split": "test"}, "test"),
        ({"place": "drop"}, "rl, stop, ik, ik\\+"),
        ({"place": "delta-1"}, "2 or more"),
        ({"place": "delta-x"}, "2 or more"),
        ({"episodes": 0}, "episodes"),
        ({"episodes": 101}, "episodes"),
        ({"train_seeds": 0}, "train_seeds"),
        ({"eval_seeds": 0}, "eval_seeds"),
    ],
)
def test_wrong_protocols_are_refused(wrong, message):
    with pytest.raises(HomeError, match=message):
        Protocol(**{"task": "set_table", **wrong})


def test_delta_decides_how_long_place_waits():
    assert Protocol("set_table", "delta-50").skills()["place"].limit == 250
    assert Protocol("set_table", "rl").skills()["place"].limit == 200
    assert Protocol("set_table", "delta-50").arm == "rl"


def test_who_acts_is_the_oracle_where_nobody_else_is_named(tmp_path):
    chosen = choose_policies("set_table", 0, {"place": "oracle", "pick": "oracle"})
    assert set(chosen) == {*("navigate", "pick", "place", "open_drawer", "close_drawer", "open_fridge", "close_fridge")}
    actors = make_actors(chosen, "ik")
    assert isinstance(actors["place"], Ik)
    assert isinstance(actors["reset_arm"], Scripted)
    assert isinstance(actors["pick"], Oracle)
    with pytest.raises(HomeError, match="juggle"):
        choose_policies("set_table", 0, {"juggle": "oracle"})
    with pytest.raises(HomeError, match="missing-3"):
        choose_policies("set_table", 3, {"place": str(tmp_path / "missing-{seed}.safetensors")})


def test_a_shipped_policy_is_named_by_its_place_and_its_content():
    shipped = SkillPolicy(str(SHIPPED / "set_table" / "place" / "seed-0.safetensors"), "0123456789", object())
    assert shipped.name == "shipped set_table/place/seed-0 (SHA-256 01234567)"
    assert SkillPolicy("mine.safetensors", "0123456789", object()).name == "mine.safetensors (SHA-256 01234567)"
    assert SkillPolicy("oracle", "", None).name == "oracle"
