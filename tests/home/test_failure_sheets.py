"""Failed episodes once more: which moments are shown, and that a replay is what was logged."""

import json
import sys
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from perdure.errors import PerdureError
from perdure.film import GAP
from perdure.home.evaluate.execute import ExecutorOptions
from perdure.home.evaluate.files import read_logs, write_logs
from perdure.home.evaluate.outcomes import label
from perdure.home.evaluate.protocol import EvaluationProtocol, run_protocol
from perdure.home.failures import (
    COLUMNS,
    PICTURES,
    Logged,
    Replay,
    failure_sheet,
    picture_steps,
    read_logged,
    replay_failure,
    sample_failures,
)
from perdure.home.sim.scene import SceneOptions
from perdure.home.sim.vector_simulator import VectorSimulator
from perdure.home.skills import SKILLS
from perdure.home.tasks.episodes import episode_scene, start_pose
from perdure.home.tasks.tasks import SOMETHING_ELSE
from tests.home.limits import shorten

sys.path.insert(0, str(Path(__file__).parent / "evaluate" / "outcomes"))
from home_stories import Story

ORACLES = dict.fromkeys(SKILLS, "oracle")
NOTES = {"protocol": json.dumps(asdict(EvaluationProtocol("set_table", "ik")))}


def replay_of(story, counting="stabilizing"):
    """A story as if it had been run again; nothing of its world is known but what the log says."""
    log = story.log()
    return Replay(log, label(log, counting), np.zeros((log.length, 1)))


def shown(replay):
    return picture_steps(replay, replay.label)


def rolls_away():
    """Let go after step 8, at rest until step 14, then 10.3 mm a step for 30 steps: 0.15 m are passed at step 29."""
    return Story().go(0).slide(0, [0.31, 0.0, 0.0], 30)


def test_a_placement_is_shown_from_its_release_to_its_rest():
    """Way up to step 29: 0.176 m (a fall of 0.02, 15 steps of 0.0103, and 0.7 s), after it 0.146 m. The halves of the
    first are 0.093 m (up to step 21) and 0.083 m, those of the second 0.077 m (up to 37) and 0.07 m; then the longest
    two are halved again, in steps 17 and 25."""
    taken = shown(replay_of(rolls_away()))
    assert list(taken) == [0, 8, 17, 21, 25, 29, 37, 44]
    assert {step: note for step, note in taken.items() if note} == {8: "releases", 29: "left its goal"}


def test_an_object_that_rests_for_long_uses_up_no_pictures():
    story = Story().go(0)
    story.wait(900)
    taken = shown(replay_of(story.slide(0, [0.31, 0.0, 0.0], 30)))
    assert len(taken) == PICTURES
    assert sum(step > 14 + 900 for step in taken) >= 5


@pytest.mark.parametrize("above", [0.0, 0.02])
def test_what_was_never_in_its_goal_does_not_leave_it(above):
    taken = shown(replay_of(Story().go(0, beside=0.4, above=above)))
    assert "left its goal" not in taken.values()
    assert len(taken) == PICTURES
    assert (min(taken), max(taken)) == (0, 8 + 30)  # at rest at once; a second is shown all the same


def misses(held=None, force=0.0):
    """Navigates for 60 steps, reaches for 40 with an empty hand and comes nearest in step 73."""
    story = Story()
    with story.run("navigate", 0):
        story.wait(60)
    with story.run("pick", 0, "timed out"):
        for step in range(60, 100):
            story.gripper = story.objects[0] + [0.0, 0.0, 0.3 + 0.01 * abs(step - 73)]
            story.held = held if held is not None and step >= 80 else story.held
            story.force = force if step == 90 else 0.0
            story.wait()
    story.held = -1
    return story


def test_a_pick_is_shown_evenly_with_its_nearest_moment():
    """13 steps before it and 26 after it: the longest stretch is halved, the first one of equal ones."""
    taken = shown(replay_of(misses()))
    assert list(taken) == [60, 64, 67, 73, 80, 86, 93, 99]
    assert taken[73] == "nearest, 0.300 m away"


@pytest.mark.parametrize(
    ("wrong", "cause", "step", "note"),
    [
        ({"held": SOMETHING_ELSE}, "wrong object grasped", 80, "another object in the hand"),
        ({"force": 3000.0}, "collision", 90, "largest force, 3000 N"),
    ],
)
def test_the_moment_that_a_label_speaks_of_is_among_them(wrong, cause, step, note):
    replay = replay_of(misses(**wrong))
    assert replay.label.cause == cause
    taken = shown(replay)
    assert (len(taken), taken[step], max(taken)) == (PICTURES, note, 99)


def test_of_a_skill_that_was_over_at_once_the_last_second_is_shown():
    story = Story()
    with story.run("navigate", 0):
        story.wait(60)
    with story.run("pick", 0):
        story.wait()
    taken = shown(replay_of(story))
    assert (min(taken), max(taken), len(taken)) == (30, 60, PICTURES)


def test_a_collision_is_shown_that_came_before_the_release():
    replay = replay_of(Story().go(0, force=3000.0).slide(0, [0.31, 0.0, 0.0], 30))
    assert replay.label.cause == "collision"
    assert shown(replay)[5] == "largest force, 3000 N"  # place begins with step 5


def test_a_drawer_that_comes_open_again_is_shown_where_it_does():
    """Closed at step 60, out by 0.12 m from step 160 on; the fridge, whose stage fails by it, is opened at 270."""
    story = Story("set_table")
    story.containers["drawer"] = 0.45
    story.go(0).wait(45)
    for skill, target, drawer, fridge in (("close_drawer", 0, 0.05, 0.0), ("navigate", 1, 0.12, 0.0)):
        story.containers.update(drawer=drawer, fridge=fridge)
        with story.run(skill, target):
            story.wait(100)
    with story.run("open_fridge", 1):
        story.wait(10)
        story.containers["fridge"] = 2.0
        story.wait(10)
    replay = replay_of(story)
    assert (replay.label.stage.name, replay.label.cause) == ("open_1", "door not closed")
    taken = shown(replay)
    assert {step: note for step, note in taken.items() if note} == {160: "no longer closed"}
    assert (min(taken), max(taken), len(taken)) == (130, 279, PICTURES)


def test_a_draw_is_the_same_again_and_takes_nothing_twice():
    drawn = sample_failures(range(50), 10, seed=3)
    assert drawn == sample_failures(range(50), 10, seed=3)
    assert drawn != sample_failures(range(50), 10, seed=4)
    assert len(set(drawn)) == 10
    assert sorted(sample_failures(range(5), 10, seed=0)) == [0, 1, 2, 3, 4]
    for wrong in ({"count": 0, "seed": 0}, {"count": 1, "seed": -1}):
        with pytest.raises(PerdureError, match="or more"):
            sample_failures(range(5), **wrong)


@pytest.fixture(scope="module")
def hurried(tmp_path_factory):
    """Logs of an episode that had three steps for each skill, in an unusual world, and the same haste for a replay."""
    scene = SceneOptions(physics_hz=240, rolling=0.0, apple="hull")
    options = ExecutorOptions(lanes=1, scene=scene, settle_steps=7, eval_seed=0)
    with pytest.MonkeyPatch.context() as patch:
        shorten(patch, 3, 12)
        protocol = EvaluationProtocol("set_table", "stop", episodes=1, policies=ORACLES, options=options)
        yield run_protocol(protocol, tmp_path_factory.mktemp("runs"))


def test_a_replay_takes_the_logged_course_in_the_logged_world(hurried):
    (failure,) = read_logged(hurried, "latched")
    agent = failure.agent({})
    options = agent.protocol.options
    assert (options.scene.apple, options.scene.rolling, options.scene.physics_hz) == ("hull", 0.0, 240)
    assert (options.settle_steps, agent.protocol.place, agent.train_seed) == (7, "stop", -1)
    assert {policy.source for policy in agent.policies.values()} == {"oracle"}
    replay = replay_failure(failure, agent)
    assert replay.label == failure.label
    assert replay.log.events == failure.log.events
    assert replay.log.runs == failure.log.runs
    assert len(replay.states) == failure.log.length


def test_a_policy_for_a_skill_of_other_tasks_does_not_stop_a_replay():
    log = rolls_away().log()
    options = ExecutorOptions(settle_steps=9)
    failure = Logged(replace(log, eval_seed=2), "stabilizing", EvaluationProtocol(log.task, "ik", options=options))
    everywhere = {**ORACLES, "open_fridge": "used by set_table alone.safetensors"}
    assert "place" in failure.agent(everywhere).policies
    agent = replace(failure, log=replace(failure.log, diverged=True)).agent(everywhere)
    assert (agent.protocol.options.eval_seed, agent.protocol.options.settle_steps) == (2, 9)


def test_a_replay_with_another_policy_than_the_logged_one_is_refused():
    log, oracles = rolls_away().log(), EvaluationProtocol("prepare_groceries", policies={"place": "oracle"})
    noted = (("place", "shipped x (SHA-256 01234567)"),)
    failure = Logged(replace(log, train_seed=-1), "stabilizing", oracles, noted)
    with pytest.raises(
        PerdureError, match=r"place of these logs was shipped x \(SHA-256 01234567\), and is oracle now"
    ):
        failure.agent({})
    assert "place" in failure.agent({"place": "oracle"}).policies


def test_another_episode_under_the_same_number_is_refused(hurried, tmp_path):
    (record,) = read_logs(hurried[0])
    write_logs(tmp_path / "logs.parquet", [replace(record, episode_hash="other")], NOTES)
    (failure,) = read_logged([tmp_path / "logs.parquet"], "latched")
    with pytest.raises(PerdureError, match="set_table/val/000"):
        _ = failure.episode


def test_a_sheet_shows_where_the_object_was(tmp_path, monkeypatch):
    """States are made up: everything as at the start, but the first target where the story has it."""
    size = (240, 160)
    monkeypatch.setattr("perdure.home.failures.SIZE", size)
    monkeypatch.setattr("perdure.home.pictures.Studio.shadows", 256)  # the large ones take most of the time
    replay = replay_of(rolls_away())
    write_logs(tmp_path / "logs.parquet", [replace(replay.log, place="ik", world="drag only")], NOTES)
    (failure,) = read_logged([tmp_path / "logs.parquet"], "stabilizing")
    scene = episode_scene(failure.episode)
    world = VectorSimulator(1)
    world.reset(0, scene, start_pose(scene.apartment, failure.episode, 0))
    states = np.tile(world.simulator(0).qpos, (replay.log.length, 1))
    sheets, log = [], replay.log
    for positions, found in (
        (log.history.facts.object_positions[:, 0], failure.label),
        (log.history.facts.goal_positions[0], None),
    ):
        states[:, scene.object_qpos[0] + np.arange(3)] = positions
        try:
            sheets.append(failure_sheet(failure, replace(replay, states=states, label=found)))
        except PerdureError as error:
            if "no picture can be drawn" in str(error):
                pytest.skip("this machine has neither EGL nor OSMesa")
            raise
    height, width, _ = sheets[0].shape
    assert width == COLUMNS * (size[0] + GAP) - GAP
    assert height > 2 * size[1]
    corner = (slice(height - size[1], height), slice(width - size[0], width))
    assert (sheets[0][corner] != sheets[1][corner]).any()  # by then the object has rolled away
    title = slice(0, size[1] // 4)
    assert (sheets[0][title] != sheets[1][title]).any()  # one says why it failed, the other that it did not
