"""Which policy acts in which skill: shipped ones, files, or the oracle."""

from pathlib import Path

import pytest

from perdure.home.agents import Scripted
from perdure.home.agents.oracle import Oracle
from perdure.home.agents.release import Ik
from perdure.home.benchmark.tasks import get_task
from perdure.home.errors import HomeError
from perdure.home.evaluate.protocol import (
    EvaluationProtocol,
    choose_policies,
    logged_policies,
    make_agents,
    read_release,
    run_protocol,
)
from perdure.home.evaluate.protocol.policies import SHIPPED, SkillPolicy

ORACLES = dict.fromkeys({step.skill for step in get_task("set_table").skills} - {"reset_arm"}, "oracle")


def test_the_oracle_does_not_stand_in_for_a_policy_trained_to_make_objects_stay(tmp_path):
    with pytest.raises(HomeError, match="delta-9999"):
        run_protocol(EvaluationProtocol("set_table", "delta-9999", episodes=1), tmp_path)
    assert choose_policies("set_table", 0, {"place": "oracle"}, read_release("delta-9999"))["place"].name == "oracle"


def test_who_acts_is_the_oracle_where_nobody_else_is_named(tmp_path):
    chosen = choose_policies("set_table", 0, {"place": "oracle", "pick": "oracle"})
    assert set(chosen) == {*("navigate", "pick", "place", "open_drawer", "close_drawer", "open_fridge", "close_fridge")}
    agents = make_agents(chosen, "ik")
    assert isinstance(agents["place"], Ik)
    assert isinstance(agents["reset_arm"], Scripted)
    assert isinstance(agents["pick"], Oracle)
    with pytest.raises(HomeError, match="juggle"):
        choose_policies("set_table", 0, {"juggle": "oracle"})
    with pytest.raises(HomeError, match="missing-3"):
        choose_policies("set_table", 3, {**ORACLES, "place": str(tmp_path / "missing-{seed}.safetensors")})


@pytest.mark.parametrize(("skill", "why"), [("open_fridge", "tidy_house never uses"), ("reset_arm", "is scripted")])
def test_a_policy_for_a_skill_that_the_plan_does_not_learn_is_refused(skill, why):
    with pytest.raises(HomeError, match=f"{why}.*; the skills of tidy_house that need a policy are navigate, pick"):
        choose_policies("tidy_house", 0, {skill: "nosuch.safetensors"})


def test_the_oracle_does_not_stand_in_for_another_training_seed():
    with pytest.raises(HomeError, match="training seed 9999 is shipped for navigate on tidy_house"):
        choose_policies("tidy_house", 9999)
    assert choose_policies("tidy_house", 9999, ORACLES)["pick"].name == "oracle"


def test_what_logs_note_of_their_policies_finds_them_again(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("mine").mkdir()
    mine = Path("mine/place (1).safetensors")
    mine.write_bytes((SHIPPED / "set_table" / "place" / "seed-0.safetensors").read_bytes())
    chosen = choose_policies("set_table", 0, {"place": str(mine), "close_drawer": "oracle"})
    names = {skill: each.name for skill, each in chosen.items()}
    assert logged_policies(names) == {skill: each.source for skill, each in chosen.items()}
    mine.write_bytes(b"another")
    for wrong, why in (
        (names, "another one now: --policies place=FILE"),
        ({"pick": "shipped set_table/pick/seed-9999 (SHA-256 0123abcd)"}, "pick.*is missing"),
        ({"pick": "somebody"}, "names no file"),
    ):
        with pytest.raises(HomeError, match=why):
            logged_policies(wrong)
    assert "place" not in logged_policies(names, without={"place"})


def test_navigation_is_learned_on_one_task_for_all():
    names = {
        task: choose_policies(task, 0)["navigate"].name for task in ("set_table", "tidy_house", "prepare_groceries")
    }
    assert names["tidy_house"] == names["prepare_groceries"] == names["set_table"]
    assert names["set_table"].startswith("shipped set_table/navigate/seed-0")
    assert choose_policies("tidy_house", 0, {"navigate": "oracle"})["navigate"].name == "oracle"


def test_a_shipped_policy_is_named_by_its_place_and_its_content():
    shipped = SkillPolicy(str(SHIPPED / "set_table" / "place" / "seed-0.safetensors"), "0123456789", object())
    assert shipped.name == "shipped set_table/place/seed-0 (SHA-256 01234567)"
    assert SkillPolicy("mine.safetensors", "0123456789", object()).name == "mine.safetensors (SHA-256 01234567)"
    assert SkillPolicy("oracle", "", None).name == "oracle"
