"""The protocol: which parts, who acts, and that a second call runs nothing again."""

import json
import threading
from dataclasses import asdict

import numpy as np
import pytest

from perdure.errors import OtherSourceWarning, PerdureError
from perdure.home.evaluate.execute import Executor, ExecutorOptions
from perdure.home.evaluate.files import read_log_file, read_logs
from perdure.home.evaluate.policies import SHIPPED, _load, choose_policies, make_agents, read_release
from perdure.home.evaluate.protocol import (
    EvaluationProtocol,
    episode_blocks,
    noted_protocol,
    protocol_units,
    run_block,
    run_protocol,
)
from perdure.home.sim.scene import SceneOptions
from perdure.home.tasks.episodes import load_episodes
from perdure.home.tasks.planning import make_plan
from perdure.horizon import Constant
from perdure.runs import Store, Work
from tests.home.limits import shorten

LEARNED = {step.skill for step in make_plan("set_table")} - {"reset_arm"}
ORACLES = dict.fromkeys(LEARNED, "oracle")
NOWHERE = Store("/nowhere")


def test_units_cover_every_episode_of_every_seed_once():
    protocol = EvaluationProtocol("set_table", episodes=25, train_seeds=2, eval_seeds=3)
    seen = [
        (part.train_seed, part.eval_seed, episode)
        for part in episode_blocks(protocol, NOWHERE)
        for episode in range(part.first, part.last + 1)
    ]
    assert sorted(seen) == [(t, e, k) for t in range(2) for e in range(3) for k in range(25)]
    keys = [part.key for part in episode_blocks(protocol, NOWHERE)]
    assert len(set(keys)) == len(keys)


def test_more_or_fewer_episodes_repeat_none(tmp_path):
    store, spans = Store(tmp_path), []
    for episodes in (1, 60, 3, 99):
        protocol = EvaluationProtocol("set_table", episodes=episodes)
        blocks = list(episode_blocks(protocol, store))
        spans.append([(block.first, block.last) for block in blocks])
        for key in (block.key for block in blocks):
            if not store.done(key):
                with store.workspace(key, {}):
                    pass
    most = [(0, 0), (1, 49), (50, 59), (60, 98)]
    assert spans == [most[:1], most[:3], most[:2], most]


@pytest.mark.parametrize("policies", [ORACLES, {**ORACLES, "place": "shipped"}])
def test_copies_of_one_policy_are_no_training_seeds(policies):
    if policies["place"] == "shipped":
        policies = {**policies, "place": EvaluationProtocol("set_table").policies_of(0)["place"].source}
    protocol = EvaluationProtocol("set_table", episodes=1, train_seeds=2, policies=policies)
    with pytest.raises(PerdureError, match=r"training seeds 0 and 1 have the same policies: name files with \{seed\}"):
        list(protocol_units(protocol, "", NOWHERE))


ONE = EvaluationProtocol("set_table", episodes=1, policies=ORACLES, options=ExecutorOptions(lanes=1))


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """The folder of a hurried run of `ONE`, its logs, and what its observer saw."""
    folder, seen = tmp_path_factory.mktemp("ran"), []
    with pytest.MonkeyPatch.context() as patch:
        shorten(patch, 3, 8)
        logs = run_protocol(ONE, folder, observe=seen.append, command="asked by a test")
    return folder, logs, seen


def test_what_was_run_is_not_run_again(ran):
    folder, first, seen = ran
    _say_other_source_made(first[0].parent)
    with pytest.warns(OtherSourceWarning, match="1 of 1"):
        second = run_protocol(ONE, folder, observe=lambda status: pytest.fail("nothing is left to run"))
    assert first == second
    (progress,) = seen[-1].values()
    assert (progress.state, progress.done) == ("finished", 1)
    (record,) = read_logs(first[0])
    assert record.index == 0
    _, notes = read_log_file(first[0])
    assert json.loads(notes["policies"])["place"] == "oracle"
    assert (notes["command"], record.train_seed) == ("asked by a test", -1)
    assert noted_protocol(notes, "it") == ONE


def test_two_runs_into_one_folder_do_the_work_once(tmp_path, monkeypatch):
    calls, states, run = [], [], Executor.run

    def counted(self, episodes):
        calls.append(len(episodes))
        return run(self, episodes)

    monkeypatch.setattr(Executor, "run", counted)
    shorten(monkeypatch, 3, 8)
    see = states.append
    both = [
        threading.Thread(target=run_protocol, args=(ONE, tmp_path), kwargs={"observe": lambda s: see(_states(s))})
        for _ in range(2)
    ]
    for each in both:
        each.start()
    for each in both:
        each.join()
    assert calls == [1]
    assert {"busy", "finished"} <= set().union(*states), "the second one says that it waits"


def _states(status):
    return {each.state for each in status.values()}


def _say_other_source_made(unit):
    record = json.loads((unit / "unit.json").read_text())
    (unit / "unit.json").write_text(json.dumps({**record, "sources": ["another"]}))


def test_other_settings_under_the_same_name_are_refused(tmp_path, monkeypatch):
    shorten(monkeypatch, 3, 8)

    def protocol(settle_steps):
        options = ExecutorOptions(lanes=1, settle_steps=settle_steps)
        return EvaluationProtocol("set_table", episodes=1, policies={"place": "oracle"}, options=options)

    run_protocol(protocol(2), tmp_path)
    with pytest.raises(PerdureError, match="settle_steps"):
        run_protocol(protocol(3), tmp_path)


def test_a_stored_configuration_names_the_scene_only_where_it_is_unusual():
    def config(**scene):
        options = ExecutorOptions(scene=SceneOptions(**scene))
        protocol = EvaluationProtocol("set_table", episodes=1, policies=ORACLES, options=options)
        return next(protocol_units(protocol, "", NOWHERE)).config

    usual = config()
    committed = {"apple", "episodes", "eval_seed", "mujoco", "perdure", "physics_hz", "place", "policies"}
    committed |= {"grasp", "base_speed"}  # so that nothing of the earlier physics is reused
    committed |= {"rolling", "settle_steps", "split", "task", "train_seed"}
    assert set(usual) == committed
    assert config(clutter=False) == {**usual, "clutter": False}


def test_an_unusual_world_has_a_name_and_a_folder_of_its_own():
    usual = EvaluationProtocol("set_table", "guarded")
    unusual = EvaluationProtocol(
        "set_table", "guarded", options=ExecutorOptions(scene=SceneOptions(apple="hull", rolling=0.0))
    )
    assert (usual.strategy.name, usual.folder) == ("guarded", "set_table/val/guarded")
    assert unusual.strategy.name == "guarded, drag only, apple a convex hull"
    assert unusual.folder == "set_table/val/guarded-drag-hull-apple"


@pytest.mark.verify
@pytest.mark.parametrize("policies", [ORACLES, {}], ids=["oracle", "learned"])
def test_processes_side_by_side_write_the_same_logs(policies, tmp_path, monkeypatch):
    monkeypatch.setattr("perdure.home.evaluate.protocol.BLOCK", 1)
    options = ExecutorOptions(lanes=1, settle_steps=2)
    protocol = EvaluationProtocol("set_table", episodes=2, policies=policies, options=options)
    seen = []
    alone = run_protocol(protocol, tmp_path / "alone")
    together = run_protocol(protocol, tmp_path / "together", on="local", cores=2, observe=seen.append)
    assert [each.state for each in seen[-1].values()] == ["finished"] * 2
    assert [path.read_bytes() for path in together] == [path.read_bytes() for path in alone]


def test_a_protocol_for_another_process_is_the_same_one():
    scene = SceneOptions(apple="hull", rolling=0.0, clutter=False)
    options = ExecutorOptions(eval_seed=3, lanes=2, threads=1, scene=scene)
    protocol = EvaluationProtocol("tidy_house", "guarded", "eval", 7, 2, 3, {"pick": "oracle"}, options)
    assert noted_protocol({"protocol": json.dumps(asdict(protocol))}, "it") == protocol


def test_a_policy_that_changed_meanwhile_is_refused(tmp_path):
    path = tmp_path / "place.safetensors"
    path.write_bytes((SHIPPED / "set_table/place/seed-0.safetensors").read_bytes())
    protocol = EvaluationProtocol("set_table", episodes=1, policies={**ORACLES, "place": str(path)})
    unit = next(protocol_units(protocol, "", NOWHERE))
    path.write_bytes((SHIPPED / "set_table/pick/seed-0.safetensors").read_bytes())
    _load.cache_clear()  # as in another process
    with pytest.raises(PerdureError, match=r"place\.safetensors has changed"):
        run_block(Work(tmp_path, 1, print), **unit.arguments)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"task": "make_coffee"}, "make_coffee"),
        ({"split": "test"}, "test"),
        ({"place": "drop"}, "rl, stop, ik, guarded"),
        ({"place": "delta-1"}, "2 or more"),
        ({"place": "delta-x"}, "2 or more"),
        ({"place": "delta-"}, "2 or more"),
        ({"place": "delta-\u00b2"}, "2 or more"),
        ({"place": "delta-50 in 200"}, "2 or more"),
        ({"place": "gentle-50"}, "linear-N or geometric-N, not 'gentle-50'"),
        ({"episodes": 0}, "episodes"),
        ({"episodes": 101}, "episodes"),
        ({"train_seeds": 0}, "train_seeds"),
        ({"eval_seeds": 0}, "eval_seeds"),
    ],
)
def test_wrong_protocols_are_refused(wrong, message):
    with pytest.raises(PerdureError, match=message):
        EvaluationProtocol(**{"task": "set_table", **wrong})


def test_delta_decides_how_long_place_waits():
    assert EvaluationProtocol("set_table", "delta-50").skills()["place"].limit == 250
    assert EvaluationProtocol("set_table", "rl").skills()["place"].limit == 200
    assert EvaluationProtocol("set_table", "delta-50").release.strategy == "rl"


def test_a_place_policy_that_was_trained_otherwise_is_a_release():
    names = ("rl", "guarded", "delta-50", "gentle", "geometric-50")
    read = [read_release(name) for name in names]
    assert [each.policy for each in read] == ["place", "place", "place-delta-50", "place-gentle", "place-geometric"]
    assert [each.strategy for each in read] == ["rl", "guarded", "rl", "rl", "rl"]
    assert [each.clock for each in read] == [None, None, None, None, Constant(50.0)]
    assert EvaluationProtocol("set_table", "gentle").skills()["place"].gentle


@pytest.mark.verify
def test_learned_policies_act_alike_whoever_runs_beside_them():
    """Seeing is shared between lanes, so that neighbors could show in the last bit of what a policy sees."""
    protocol, episodes = EvaluationProtocol("set_table"), load_episodes("set_table", "val").episodes[:5]
    agents = make_agents(choose_policies("set_table", 0), "rl")

    def run(lanes):
        executor = Executor(protocol.skills(), agents, ExecutorOptions(lanes=lanes, settle_steps=2))
        return {log.index: log for log in executor.run(episodes)}

    alone, together = run(1), run(5)
    for index, log in alone.items():
        assert together[index].runs == log.runs
        for name in ("base", "gripper", "speed", "force"):
            assert np.array_equal(getattr(together[index].history, name), getattr(log.history, name)), (index, name)
