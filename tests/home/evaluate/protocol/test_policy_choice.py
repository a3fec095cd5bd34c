"""Which policy acts in which skill: shipped ones, files, or the oracle."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from perdure.errors import PerdureError
from perdure.home.agents.learned import Scripted
from perdure.home.agents.release import Ik
from perdure.home.agents.scripted import Oracle
from perdure.home.evaluate import policies
from perdure.home.evaluate.policies import SHIPPED, SkillPolicy, choose_policies, make_agents, read_release
from perdure.home.evaluate.protocol import EvaluationProtocol, protocol_units, run_protocol
from perdure.home.skills import get_skill
from perdure.home.tasks.planning import make_plan
from perdure.horizon import Constant
from perdure.runs import Store

ORACLES = dict.fromkeys({step.skill for step in make_plan("set_table")} - {"reset_arm"}, "oracle")


def test_the_oracle_does_not_stand_in_for_a_policy_trained_to_make_objects_stay(tmp_path):
    with pytest.raises(PerdureError, match="delta-9999"):
        run_protocol(EvaluationProtocol("set_table", "delta-9999", episodes=1), tmp_path)
    assert choose_policies("set_table", 0, {"place": "oracle"}, read_release("delta-9999"))["place"].name == "oracle"


def test_who_acts_is_the_oracle_where_nobody_else_is_named(tmp_path):
    chosen = choose_policies("set_table", 0, {"place": "oracle", "pick": "oracle"})
    assert set(chosen) == {*("navigate", "pick", "place", "open_drawer", "close_drawer", "open_fridge", "close_fridge")}
    agents = make_agents(chosen, "ik")
    assert agents["place"].strategy == Ik()
    assert isinstance(agents["reset_arm"], Scripted)
    assert isinstance(agents["pick"], Oracle)
    with pytest.raises(PerdureError, match="juggle"):
        choose_policies("set_table", 0, {"juggle": "oracle"})
    with pytest.raises(PerdureError, match="missing-3"):
        choose_policies("set_table", 3, {**ORACLES, "place": str(tmp_path / "missing-{seed}.safetensors")})


@pytest.mark.parametrize(("skill", "why"), [("open_fridge", "tidy_house never uses"), ("reset_arm", "is scripted")])
def test_a_policy_for_a_skill_that_the_plan_does_not_learn_is_refused(skill, why):
    with pytest.raises(PerdureError, match=f"{why}.*; the skills of tidy_house that need a policy are navigate, pick"):
        choose_policies("tidy_house", 0, {skill: "nosuch.safetensors"})


def test_the_oracle_does_not_stand_in_for_another_training_seed():
    with pytest.raises(PerdureError, match=r"for navigate on tidy_house.* navigate --task set_table --seeds 9999"):
        choose_policies("tidy_house", 9999)
    assert choose_policies("tidy_house", 9999, ORACLES)["pick"].name == "oracle"


def test_navigation_is_learned_on_one_task_for_all():
    names = {
        task: choose_policies(task, 0)["navigate"].name for task in ("set_table", "tidy_house", "prepare_groceries")
    }
    assert names["tidy_house"] == names["prepare_groceries"] == names["set_table"]
    assert names["set_table"].startswith("shipped set_table/navigate/seed-0")
    assert choose_policies("tidy_house", 0, {"navigate": "oracle"})["navigate"].name == "oracle"


def test_training_seeds_are_numbered_by_what_is_shipped(tmp_path, monkeypatch):
    """Seed 3 where 1 and 2 failed; the task's own before one that is learned on another."""
    monkeypatch.setattr(policies, "SHIPPED", tmp_path)
    for name in ("set_table/navigate/seed-0", "set_table/navigate/seed-3", "tidy_house/navigate/seed-3"):
        path = tmp_path / f"{name}.safetensors"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    shipped = policies.shipped_seeds("tidy_house", "navigate")
    assert {seed: path.parts[-3] for seed, path in shipped.items()} == {0: "set_table", 3: "tidy_house"}
    assert list(shipped) == [0, 3]


def test_a_shipped_policy_is_named_by_its_place_and_its_content():
    shipped = SkillPolicy(SHIPPED / "set_table" / "place" / "seed-0.safetensors", "0123456789")
    assert shipped.name == "shipped set_table/place/seed-0 (SHA-256 01234567)"
    mine = SkillPolicy(Path("mine.safetensors"), "0123456789")
    assert mine.name == "mine.safetensors (SHA-256 01234567)"
    assert replace(mine, clock=Constant(50.0)).name == "mine.safetensors@constant:50 (SHA-256 01234567)"
    assert SkillPolicy().name == "oracle"


@pytest.fixture
def timed(tmp_path, monkeypatch):
    """Returns the policies of a place policy with this clock; the file has a time-to-go input or not."""
    (tmp_path / "seed-0.safetensors").write_text("")
    policies._load.cache_clear()

    def protocol(clock, has_clock=True, method=""):
        place = get_skill("place")
        task = SimpleNamespace(name="mine", observation_size=len(place.elements), action_size=place.action_size)
        policy = SimpleNamespace(has_clock=has_clock, provenance={"method": method}, task=task)
        monkeypatch.setattr(policies, "load_policy", lambda source: policy)
        place = f"{tmp_path}/seed-{{seed}}.safetensors{clock}"
        return EvaluationProtocol("set_table", episodes=1, policies={**ORACLES, "place": place})

    yield protocol
    policies._load.cache_clear()


def test_a_clock_follows_the_file(timed):
    chosen = timed("@constant:50").policies_of(0)
    assert chosen["place"].clock == make_agents(chosen, "rl")["place"].clock == Constant(50.0)
    assert choose_policies("set_table", 0, {**ORACLES, "place": chosen["place"].source}) == chosen  # as in a replay
    assert timed("").policies_of(0)["place"].clock is None
    clocks = ("", "@constant:50", "@constant:60", "@periodic:50")
    units = [next(protocol_units(timed(clock), "", Store("/nowhere"))) for clock in clocks]
    assert len({unit.config["policies"]["place"] for unit in units}) == 4


def test_the_clock_of_a_release_is_shown_whatever_follows_the_file(timed):
    for name, clock, shown in (("geometric-60", "@constant:50", 60.0), ("geometric", "@constant:50", 50.0)):
        assert replace(timed(clock), place=name).policies_of(0)["place"].clock == Constant(shown)
    assert replace(timed(""), place="geometric").policies_of(0)["place"].clock is None
    policies._load.cache_clear()
    with pytest.raises(PerdureError, match="no time-to-go input"):
        replace(timed("", has_clock=False), place="geometric").policies_of(0)


def test_a_policy_of_another_method_is_refused(timed):
    assert replace(timed("", method="place-linear"), place="linear-50").policies_of(0)["place"].clock == Constant(50.0)
    with pytest.raises(PerdureError, match="trained with --method linear, not geometric"):
        replace(timed("", method="place-linear"), place="geometric-50").policies_of(0)


def test_a_policy_that_does_not_fit_is_refused_before_anything_runs():
    mine = str(SHIPPED / "set_table" / "place" / "seed-0.safetensors")
    for skill, release, why in (
        ("pick", "rl", "another skill than pick"),
        ("place", "gentle", "gentle=False, not True"),
    ):
        with pytest.raises(PerdureError, match=why):
            choose_policies("set_table", 0, {skill: mine}, read_release(release))


def test_a_missing_policy_is_told_with_the_command_that_trains_it():
    for name, flags in (("delta-9999", "--variant delta-9999"), ("linear-7", "--method linear"), ("rl", "")):
        wanted = f"perdure home train place --task set_table {flags}{flags and ' '}--seeds 9999\\)"
        with pytest.raises(PerdureError, match=wanted):
            choose_policies("set_table", 9999, {k: v for k, v in ORACLES.items() if k != "place"}, read_release(name))


@pytest.mark.parametrize(
    ("clock", "has_clock", "why"),
    [
        ("@constant:50", False, "no time-to-go input"),
        ("@hourglass:5", True, "hourglass"),
        ("@constant", True, "no policy"),
    ],
)
def test_a_clock_that_cannot_be_is_refused_before_anything_runs(timed, clock, has_clock, why):
    with pytest.raises(PerdureError, match=why):
        timed(clock, has_clock).policies_of(0)


def test_a_policy_is_loaded_once_and_not_before_it_acts(monkeypatch):
    loaded = []
    policies._load.cache_clear()
    monkeypatch.setattr(policies, "load_policy", lambda source: loaded.append(source) or object())
    chosen = [choose_policies("set_table", 0) for _ in range(3)]
    assert loaded == []
    acting = [{skill: each.policy for skill, each in one.items()} for one in chosen]
    assert len(loaded) == len(set(loaded)) == 7
    assert acting[0] == acting[1] == acting[2]
    policies._load.cache_clear()
